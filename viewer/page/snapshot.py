"""A look as plain values for the browser, which only formats and draws them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from conveyor.messages import CameraInfo, Totals
from conveyor.messages.loads import LoadNow
from conveyor.rounding import rounded_to_sum
from viewer.page.alarms import Alarm, Level, alarms, layers
from viewer.page.state import STALE_S, WEIGHTS, LineState, NodeState, ToldLoad

FORGET_GONE_S = 600.0
MAX_NODES = 64
"""Regressors of containers have a new name at each start: those long gone are forgotten, and the list has an end."""


def snapshot(state: LineState) -> dict[str, Any]:
    """Everything the page shows of one line."""
    found = alarms(state)
    return {
        "line": state.line,
        "state": _state(state, worst=found[0].level if found else "note"),
        "heard_s": None if state.heard_s is None else round(state.heard_s, 1),
        "alarms": [{**asdict(alarm), "text": alarm.text, "fix": alarm.fix} for alarm in found],
        "load": None if state.totals is None or state.totals.no_number else _load(state.totals, state),
        "now": None if state.totals is None or state.totals.load is None else _now(state.totals.load),
        "contract": "" if state.totals is None else state.totals.contract,
        "changed_s": None if state.changed_s is None else round(state.changed_s, 1),
        "told": [_told(load, state) for load in state.told],
        "flow": asdict(state.flow) if state.in_contact and not (state.final or state.stopped) else None,
        "rate": None if state.rate is None else asdict(state.rate),
        "cameras": [_camera(name, state, _troubled(name, found)) for name in _shown_cameras(state)],
        "regressors": [_regressor(name, node) for name, node in _kept(state, "regressor").items()],
        "health": _health(state),
        "others": [_other(name, node) for name, node in _kept(state, "").items() if not _has_own_table(name)],
        "loads": [asdict(load) for load in state.loads if state.totals is None or load.run != state.totals.run],
    }


def _state(state: LineState, *, worst: Level) -> str:
    if state.final:
        return "complete"
    if state.stopped:
        return "stopped"
    if not state.in_contact:
        return "no contact"
    if worst == "trouble":
        return "trouble"
    if state.totals is None or state.totals.state == "starting":
        return "waiting"
    return "warned" if worst == "warning" else "running"


def _load(totals: Totals, state: LineState) -> dict[str, Any]:
    return {
        "run": totals.run,
        "count": totals.count,
        "seen_g": [totals.low_g, totals.weight_g, totals.high_g],
        "estimated_g": [totals.estimated_low_g, totals.estimated_weight_g, totals.estimated_high_g],
        "coverage": totals.coverage,
        "calibrated": bool(totals.calibrated_by),
        "layers": layers(totals),
        **_matter(totals),
        "step_g": totals.histogram_step_g,
        "histogram": list(totals.histogram),
        "final": totals.final,
        "age_s": round(state.totals_age_s, 1),
        "old": state.totals_age_s > STALE_S and not (totals.final or state.stopped),
    }


def _told(load: ToldLoad, state: LineState) -> dict[str, Any]:
    """A load of the ledger; the open one as the totals have it now: the list is older, and its belt goes on."""
    found, now = asdict(load), None if state.totals is None else state.totals.load
    if now is None or not load.open or now.number != load.number:
        return found
    seen = now.count or now.coverage is not None
    weights = {name: getattr(now, f"estimated_{name}") if seen else None for name in WEIGHTS}
    return {**found, **weights, "count": now.count, "coverage": now.coverage}


def _now(load: LoadNow) -> dict[str, Any]:
    return {
        "number": load.number,
        "name": load.name,
        "known": [text for text in (load.trailer, load.field, load.variety, load.customer, load.operator) if text],
        "since_unix_s": load.since_unix_s,
        "count": load.count,
        "seen_g": [load.low_g, load.weight_g, load.high_g],
        "estimated_g": [load.estimated_low_g, load.estimated_weight_g, load.estimated_high_g],
        "coverage": load.coverage,
        "calibrated": bool(load.calibrated_by),
        **_matter(load),
    }


def _matter(told: Totals | LoadNow) -> dict[str, Any]:
    """Classes of the contract, and what is no tuber, as shares of the weight; those of the classes as they are shown,
    to 0.1 %.
    """
    foreign = told.foreign
    shares = (
        None if foreign is None else (foreign.weight_percent_low, foreign.weight_percent, foreign.weight_percent_high)
    )
    percents = rounded_to_sum([each.percent for each in told.classes], digits=1)
    classes = [{**asdict(each), "percent": percent} for each, percent in zip(told.classes, percents, strict=True)]
    return {"classes": classes, "foreign_percent": shares}


def _shown_cameras(state: LineState) -> list[str]:
    """Those of the load first, where more announce themselves than are shown."""
    own = state.totals.cameras if state.totals else {}
    return sorted(sorted(state.camera_names(), key=lambda name: (name not in own, name))[:MAX_NODES])


def _troubled(camera: str, found: Iterable[Alarm]) -> bool:
    return any(alarm.level == "trouble" and alarm.values.get("camera") == camera for alarm in found)


def _camera(name: str, state: LineState, troubled: bool) -> dict[str, Any]:
    source, segmenter = state.role("camera").get(name), state.role("segmenter").get(name)
    info = state.cameras.get(name)
    last_word = info.state if info is not None and info.state in ("ended", "failed") else ""
    states = ["gone" if node.left else node.state for node in (source, segmenter) if node is not None]
    counts = _sheet(segmenter)
    begun = "ok" if counts.get("frames_processed") else "starting"  # its processes are there before its first frame
    well = "trouble" if troubled else begun if states else "waiting"
    now = next((state for state in states if state != "ok"), well)
    over = (state.final or state.stopped) and now != "ok"  # a camera that is stopped does not say that it ends
    return {
        "name": name,
        "state": last_word or ("ended" if over else now),
        "source": info.source if info is not None else "",
        "host": source.report.host if source is not None and source.report else "",
        "published": counts.get("frames_published", 0),
        "processed": counts.get("frames_processed", 0),
        "gaps": _gaps(segmenter, info),
        "per_s": segmenter.per_s.get("frames_processed") if segmenter is not None and segmenter.state == "ok" else None,
        "age_ms": segmenter.level("frame_age_ms") if segmenter is not None else None,
        "drift_mm": segmenter.level("belt_drift_mm") if segmenter is not None else None,
        "scaled_percent": _scaled_percent(segmenter),
        "drops": _reasons(counts, "frames_dropped_"),
        "views_lost": _reasons(counts, "views_lost_"),
        "refused": dict(info.refused) if info is not None else {},
        "tubers": counts.get("tracks_counted", 0),
    }


def _scaled_percent(segmenter: NodeState | None) -> float | None:
    """By how much tubers are made larger (smaller, below 0) to agree with the belt's travel, percent of their length;
    None where that is not the gauge, or says nothing yet.
    """
    farther = segmenter.level("scaled_by_travel") if segmenter is not None and segmenter.alive else None
    return round(100 * (1 / (1 + farther) - 1), 2) if farther else None


def _gaps(segmenter: NodeState | None, info: CameraInfo | None) -> int:
    """Frames that never arrived. Not those still under way: a camera that waits sends them until they are there."""
    if segmenter is None:
        return 0
    if info is not None and info.waits and info.state == "streaming":
        return sum(info.refused.values())
    return int(segmenter.lowest.get("frames_gaps", 0))


def _sheet(node: NodeState | None) -> dict[str, int]:
    if node is None or node.report is None:
        return {}
    return {name: int(value) for name, value in {**node.report.gauges, **node.report.values}.items()}


def _reasons(counts: dict[str, int], head: str) -> dict[str, int]:
    """Counts by reason, those that happened."""
    return {name.removeprefix(head): n for name, n in sorted(counts.items()) if name.startswith(head) and n}


def _kept(state: LineState, role: str) -> dict[str, NodeState]:
    nodes = state.role(role) if role else state.nodes
    kept = {name: node for name, node in nodes.items() if node.alive or node.away_s < FORGET_GONE_S}
    return dict(sorted(kept.items(), key=lambda item: (not item[1].alive, item[0]))[:MAX_NODES])


def _health(state: LineState) -> dict[str, Any]:
    """How many processes there are, and the states of those that are not well; who ended on purpose is told apart."""
    nodes = {name: node.state for name, node in _kept(state, "").items()}
    return {
        "processes": len(nodes),
        "well": sum(found == "ok" for found in nodes.values()),
        "ended": [name for name, found in nodes.items() if found == "ended"],
        "ill": {name: found for name, found in nodes.items() if found not in ("ok", "ended", "starting")},
    }


def _regressor(name: str, node: NodeState) -> dict[str, Any]:
    return {
        **_other(name, node),
        "weighed": node.count("views_weighed"),
        "per_s": node.per_s.get("views_weighed") if node.state == "ok" else None,
        "last_ms": node.level("last_ms"),
        "refused": sum(n for what, n in _sheet(node).items() if what.startswith("views_refused_")),
    }


def _other(name: str, node: NodeState) -> dict[str, Any]:
    return {
        "name": name,
        "state": node.state,
        "host": node.report.host if node.report else "",
        "version": node.report.version if node.report else "",
        "up_s": round(node.report.uptime_s) if node.report else None,
    }


def _has_own_table(name: str) -> bool:
    return name.startswith(("camera/", "segmenter/", "regressor/"))
