"""What is wrong with a line, in plain words, and what to do about it: a line's state in, alarms out, worst first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from conveyor.layers import layers_in_words
from viewer.page.camera_alarms import camera_alarms
from viewer.page.state import STALE_S, LineState
from viewer.page.words import AGGREGATOR_FIX, AGGREGATOR_REFUSALS, span

Level = Literal["trouble", "warning", "note"]
LEVELS: tuple[Level, ...] = ("trouble", "warning", "note")
"""'trouble': figures are wrong or missing now; 'warning': they soon may be; 'note': good to know."""
MAX_ALARMS = 24
LEFT_NOTED_S = 60.0
"""A regressor may leave at any time: that is worth a minute's note."""
LITTLE_COVERAGE = 0.98
ENOUGH_TUBERS = 20
UNCOMMITTED = 200


@dataclass(frozen=True, slots=True)
class Alarm:
    """`key` stays the same while the alarm lasts; `text` may carry how long it has lasted."""

    key: str
    level: Level
    text: str
    fix: str


def alarms(state: LineState, *, most: int = MAX_ALARMS) -> tuple[Alarm, ...]:
    """What is wrong, the worst `most` first. Where there is no contact, that is the one thing to say."""
    if not state.in_contact:
        return _no_contact(state)
    found = [
        *_aggregator(state),
        *_cameras(state),
        *_regressors(state),
        *_stalled(state),
        *_sight(state),
        *_coverage(state),
        *_layers(state),
        *_versions(state),
    ]
    return tuple(sorted(found, key=lambda alarm: LEVELS.index(alarm.level))[:most])


def _no_contact(state: LineState) -> tuple[Alarm, ...]:
    if state.final and state.heard_s is not None:
        text = f"The run is complete. The line switched off {span(state.heard_s)} ago."
        return (Alarm("off", "note", text, "Nothing needs to be done."),)
    since = "" if state.heard_s is None else f" for {span(state.heard_s)}"
    text = f"No contact with line {state.line}{since}." + (f" {state.trouble}." if state.trouble else "")
    fix = "The line may still be counting. See that its computer is on and the network cable is plugged in."
    return (Alarm("no-contact", "trouble", text, fix),)


def _aggregator(state: LineState) -> Iterator[Alarm]:
    node = state.role("aggregator").get("aggregator")
    if state.totals is None:
        if node is None or node.left:
            yield Alarm(
                "no-aggregator",
                "trouble",
                "The ledger is not kept: the aggregator is not running.",
                "Start it. Cameras keep what they count on their own disk until it is back.",
            )
        return
    if state.totals_age_s > STALE_S and not state.final:
        yield Alarm(
            "totals-old",
            "trouble",
            f"These figures are {span(state.totals_age_s)} old: the aggregator sends none.",
            "Start the aggregator again. Cameras keep what they count on their own disk until it is back.",
        )
    if node is not None:
        for counter, text in AGGREGATOR_REFUSALS.items():
            if counter in node.growing_s:
                yield Alarm(counter, "trouble", text, AGGREGATOR_FIX)


def _cameras(state: LineState) -> Iterator[Alarm]:
    for name in state.camera_names():
        for key, serious, text, fix in camera_alarms(name, state):
            yield Alarm(f"camera-{name}-{key}", "trouble" if serious else "warning", text, fix)


def _regressors(state: LineState) -> Iterator[Alarm]:
    nodes = state.role("regressor")
    segmenters = state.role("segmenter").values()
    waiting = sum(int(node.level("views_outstanding") or 0) for node in segmenters if node.alive)
    if not any(node.alive for node in nodes.values()) and segmenters and not state.final:
        yield Alarm(
            "no-regressor",
            "trouble" if waiting or nodes else "note",
            f"No regressor is running: {waiting} views wait to be weighed.",
            "Start a regressor on any computer of the line. Tubers are counted; their weights follow when it runs.",
        )
    for name, node in nodes.items():
        if node.left and node.away_s < LEFT_NOTED_S and not state.final:
            yield Alarm(
                f"regressor-{name}-left",
                "note",
                f"Regressor {name} left {span(node.away_s)} ago; the others took over its work.",
                "If that was not wanted, look at its computer.",
            )
        if "views_refused_not_finite" in node.growing_s:
            yield Alarm(
                f"regressor-{name}-refuses",
                "warning",
                f"Regressor {name} gets views that cannot be weighed.",
                "Read its log; look at the cameras' pictures.",
            )


def _stalled(state: LineState) -> Iterator[Alarm]:
    for name, node in sorted(state.nodes.items()):
        if node.state == "stalled":
            host = node.report.host if node.report else "its computer"
            yield Alarm(
                f"stalled-{name}", "trouble", f"{name} on {host} hangs.", "Restart it; read its log to see what it did."
            )
        waiting = node.level("log_uncommitted")
        if node.alive and waiting is not None and waiting > UNCOMMITTED and not state.final:
            yield Alarm(
                f"uncommitted-{name}",
                "warning",
                f"{waiting:.0f} entries of {name} wait for the ledger; they are safe on its disk.",
                "Look at the aggregator and its disk.",
            )


def _versions(state: LineState) -> Iterator[Alarm]:
    """Nodes that run another version than the one that keeps the ledger, or than most where none does."""
    found = {name: node.report.version for name, node in sorted(state.nodes.items()) if node.alive and node.report}
    if len(set(found.values())) < 2:
        return
    most = Counter(found.values()).most_common(1)[0][0]
    usual = found.get("aggregator/aggregator", most)
    others = {name: version for name, version in found.items() if version != usual}
    name, version = next(iter(others.items()))
    more = f" and {len(others) - 1} more" if len(others) > 1 else ""
    yield Alarm(
        "versions",
        "warning",
        f"Version {version} on {name}{more}; the line runs {usual}.",
        "Install the same version on every computer of the line.",
    )


def _sight(state: LineState) -> Iterator[Alarm]:
    totals = state.totals
    if totals is not None and totals.state == "nothing seen":
        fix = "Look at the cameras' pictures and their logs; this is no empty load."
        yield Alarm("nothing-seen", "trouble", f"Nothing was seen: {totals.reason}.", fix)
    elif totals is not None and totals.state == "starting":
        fix = "Wait, or see why it does not come."
        yield Alarm("starting", "warning", f"Starting, not counting: {totals.reason}.", fix)


def _layers(state: LineState) -> Iterator[Alarm]:
    totals = state.totals
    said = "" if totals is None else layers_in_words(totals.hidden, totals.layered_m, totals.belt_m)
    if said:
        yield Alarm(
            "layers",
            "warning",
            f"{said[0].upper()}{said[1:]}. The estimate makes up for them.",
            "Run the belt faster, or feed it less, until tubers lie side by side.",
        )


def _coverage(state: LineState) -> Iterator[Alarm]:
    totals = state.totals
    if totals is None or totals.coverage is None or totals.count < ENOUGH_TUBERS:
        return
    if totals.coverage < LITTLE_COVERAGE:
        yield Alarm(
            "coverage",
            "warning",
            f"{100 * (1 - totals.coverage):.1f} % of the belt was not looked at. The estimate makes up for it.",
            "See which camera dropped frames or was away, below.",
        )
