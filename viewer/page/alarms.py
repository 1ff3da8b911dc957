"""What is wrong with a line, in plain words, and what to do about it: a line's state in, alarms out, worst first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

from conveyor.messages import Totals
from conveyor.statistics import NORMAL_90
from viewer.page.camera_alarms import camera_alarms
from viewer.page.state import STALE_S, LineState, NodeState
from viewer.page.words import AGGREGATOR_REFUSALS, Value, said

Level = Literal["trouble", "warning", "note"]
LEVELS: tuple[Level, ...] = ("trouble", "warning", "note")
"""'trouble': figures are wrong or missing now; 'warning': they soon may be; 'note': good to know."""
MAX_ALARMS = 24
LEFT_NOTED_S = 60.0
"""A regressor may leave at any time: that is worth a minute's note."""
LITTLE_COVERAGE = 0.98
ENOUGH_TUBERS = 20
UNCOMMITTED = 200
REFUSED_S, MANY_REFUSED = 5.0, 0.1
"""A regressor's views are told as trouble where over such a time so large a share of them cannot be weighed."""


@dataclass(frozen=True, slots=True)
class Alarm:
    """`key` stays the same while the alarm lasts; `say` and `todo` are keys of the table of words, with `values`."""

    key: str
    level: Level
    say: str
    todo: str
    values: Mapping[str, Value] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """What is wrong, in English; may say how long it has lasted."""
        return said(self.say, self.values)

    @property
    def fix(self) -> str:
        """What to do, in English."""
        return said(self.todo, self.values)


def alarms(state: LineState, *, most: int = MAX_ALARMS) -> tuple[Alarm, ...]:
    """What is wrong, the worst `most` first. Where the line was stopped or there is no contact, that is all to say."""
    if state.stopped:
        since_s = max(node.away_s for node in state.role("aggregator").values())
        return (Alarm("stopped", "note", "alarm.stopped", "todo.stopped", {"for": since_s}),)
    if not state.in_contact:
        return _no_contact(state)
    found = [
        *_aggregator(state),
        *_cameras(state),
        *_regressors(state),
        *_receivers(state),
        *_stalled(state),
        *_sight(state),
        *_coverage(state),
        *_layers(state),
        *_heights(state),
        *_apart(state),
        *_exchanged(state),
        *_versions(state),
    ]
    return tuple(sorted(found, key=lambda alarm: LEVELS.index(alarm.level))[:most])


def _no_contact(state: LineState) -> tuple[Alarm, ...]:
    if state.final and state.heard_s is not None:
        return (Alarm("off", "note", "alarm.off", "todo.off", {"for": state.heard_s}),)
    values: dict[str, Value] = {"line": state.line, "router": state.no_router}
    say = "alarm.no_router" if state.no_router else "alarm.no_contact"
    if state.heard_s is not None:
        say, values["for"] = f"{say}_for", state.heard_s
    return (Alarm("no-contact", "trouble", say, "todo.no_contact", values),)


def _aggregator(state: LineState) -> Iterator[Alarm]:
    node = state.role("aggregator").get("aggregator")
    if state.totals is None:
        if node is None or node.left:
            yield Alarm("no-aggregator", "trouble", "alarm.no_aggregator", "todo.no_aggregator")
        return
    if state.totals_age_s > STALE_S and not state.final:
        yield Alarm("totals-old", "trouble", "alarm.totals_old", "todo.totals_old", {"for": state.totals_age_s})
    if node is not None:
        for counter in AGGREGATOR_REFUSALS:
            if counter in node.growing_s:
                yield Alarm(counter, "trouble", f"alarm.{counter}", "todo.entries")


def _cameras(state: LineState) -> Iterator[Alarm]:
    for name in state.camera_names():
        for key, serious, say, todo, values in camera_alarms(name, state):
            level: Level = "trouble" if serious else "warning"
            yield Alarm(f"camera-{name}-{key}", level, say, todo, {"camera": name, **values})


def _regressors(state: LineState) -> Iterator[Alarm]:
    nodes = state.role("regressor")
    segmenters = state.role("segmenter").values()
    waiting = sum(int(node.level("views_outstanding") or 0) for node in segmenters if node.alive)
    running = any(node.alive for node in nodes.values())
    if not running and segmenters and not state.final:
        level: Level = "trouble" if waiting or nodes else "note"
        yield Alarm("no-regressor", level, "alarm.no_regressor", "todo.no_regressor", {"n": waiting})
    for name, node in nodes.items():
        if running and node.left and node.away_s < LEFT_NOTED_S and not state.final:
            values: dict[str, Value] = {"name": name, "for": node.away_s}
            yield Alarm(f"regressor-{name}-left", "note", "alarm.regressor_left", "todo.regressor_left", values)
        if _refuses(node):
            key = f"regressor-{name}-refuses"
            yield Alarm(key, "warning", "alarm.regressor_refuses", "todo.regressor_refuses", {"name": name})


def _refuses(node: NodeState) -> bool:
    """More of the views that it gets than clods and cut tubers account for cannot be weighed, and not for a moment."""
    reasons = [counter for counter in node.per_s if counter.startswith("views_refused_")]
    refused_per_s = sum(node.per_s[counter] for counter in reasons)
    lasts_s = max((node.growing_s.get(counter, 0.0) for counter in reasons), default=0.0)
    return lasts_s >= REFUSED_S and refused_per_s > MANY_REFUSED * (
        refused_per_s + node.per_s.get("views_weighed", 0.0)
    )


def _receivers(state: LineState) -> Iterator[Alarm]:
    """Positions that are not heard are lost: the map lacks them for good."""
    for name, node in state.role("gnss").items():
        if node.left and node.state != "ended" and not state.final:
            yield Alarm(f"gnss-{name}-gone", "warning", "alarm.gnss_gone", "todo.gnss_gone", {"for": node.away_s})


def _stalled(state: LineState) -> Iterator[Alarm]:
    for name, node in sorted(state.nodes.items()):
        if node.state == "stalled":
            host = node.report.host if node.report else "?"
            yield Alarm(f"stalled-{name}", "trouble", "alarm.stalled", "todo.stalled", {"name": name, "host": host})
        waiting = node.level("log_uncommitted")
        if node.alive and waiting is not None and waiting > UNCOMMITTED and not state.final:
            values: dict[str, Value] = {"name": name, "n": int(waiting)}
            yield Alarm(f"uncommitted-{name}", "warning", "alarm.uncommitted", "todo.uncommitted", values)


def _versions(state: LineState) -> Iterator[Alarm]:
    """Nodes that run another version than the one that keeps the ledger, or than most where none does."""
    found = {name: node.report.version for name, node in sorted(state.nodes.items()) if node.alive and node.report}
    if len(set(found.values())) < 2:
        return
    most = Counter(found.values()).most_common(1)[0][0]
    usual = found.get("aggregator/aggregator", most)
    others = {name: version for name, version in found.items() if version != usual}
    name, version = next(iter(others.items()))
    values: dict[str, Value] = {"other": version, "name": name, "usual": usual, "n": len(others) - 1}
    yield Alarm(
        "versions", "warning", "alarm.versions" if len(others) > 1 else "alarm.version", "todo.versions", values
    )


def _sight(state: LineState) -> Iterator[Alarm]:
    totals = state.totals
    if totals is not None and totals.state == "nothing seen":
        yield Alarm("nothing-seen", "trouble", "alarm.nothing_seen", "todo.nothing_seen", {"why": totals.reason})
    elif totals is not None and totals.state == "starting":
        yield Alarm("starting", "warning", "alarm.starting", "todo.starting", {"why": totals.reason})


def _layers(state: LineState) -> Iterator[Alarm]:
    totals = state.totals
    if totals is not None and (values := layers(totals)):
        yield Alarm("layers", "warning", "alarm.layers", "todo.layers", values)


def _heights(state: LineState) -> Iterator[Alarm]:
    """Tubers that lie lower, or higher, than those of earlier loads."""
    load = None if state.totals is None else state.totals.load
    for change in () if load is None else load.heights:
        if change.alarm:
            values: dict[str, Value] = {
                "camera": change.cameras,
                "mm": abs(change.lower_mm),
                "sure": NORMAL_90 * change.lower_sd_mm,
                "scale": change.scale_percent,
                "scale_sure": NORMAL_90 * change.scale_sd_percent,
            }
            say = "alarm.heights_lower" if change.lower_mm > 0 else "alarm.heights_higher"
            yield Alarm(f"camera-{change.cameras}-heights", "warning", say, "todo.heights", values)


def _apart(state: LineState) -> Iterator[Alarm]:
    """Two cameras that put the same tubers at different places."""
    for apart in () if state.totals is None else state.totals.apart:
        if apart.alarm:
            values: dict[str, Value] = {
                "first": apart.first,
                "second": apart.second,
                "along": abs(apart.along_mm),
                "across": abs(apart.across_mm),
                "twice": apart.twice,
                "n": apart.shared,
            }
            level: Level = "trouble" if apart.twice else "warning"
            say = "alarm.apart_twice" if apart.twice else "alarm.apart"
            yield Alarm(f"apart-{apart.first}-{apart.second}", level, say, "todo.apart", values)


def _exchanged(state: LineState) -> Iterator[Alarm]:
    """Cameras that are not those that were calibrated."""
    for change in () if state.totals is None else state.totals.exchanged:
        values: dict[str, Value] = {"camera": change.camera, "before": change.before, "now": change.now}
        key = f"camera-{change.camera}-exchanged"
        yield Alarm(key, "warning", "alarm.exchanged", "todo.exchanged", values)


def layers(totals: Totals) -> dict[str, Value]:
    """Where tubers lie in more than one layer, and how many are hidden; empty where the belt carries one."""
    if totals.layered_m <= 0:
        return {}
    share = 100 * min(1.0, totals.layered_m / totals.belt_m) if totals.belt_m else None
    where = f"{totals.layered_m:.1f} m" if share is None else "<1 %" if share < 1 else f"{share:.0f} %"
    return {"where": where, "n": round(totals.hidden)}


def _coverage(state: LineState) -> Iterator[Alarm]:
    totals = state.totals
    if totals is not None and totals.belt_unknown:
        yield Alarm("coverage", "warning", "alarm.coverage_unknown", "todo.coverage_unknown", {"why": totals.reason})
    if totals is None or totals.coverage is None or totals.count < ENOUGH_TUBERS:
        return
    if totals.coverage < LITTLE_COVERAGE:
        percent = 100 * (1 - totals.coverage)
        yield Alarm("coverage", "warning", "alarm.coverage", "todo.coverage", {"percent": percent})
