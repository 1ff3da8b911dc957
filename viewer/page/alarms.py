"""What is wrong with a line, in plain words, and what to do about it. Pure: a look in, alarms out, the worst first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from viewer.page.camera_alarms import camera_alarms
from viewer.page.state import STALE_S, Look
from viewer.page.words import AGGREGATOR_MEND, AGGREGATOR_REFUSALS, span

Level = Literal["trouble", "look", "note"]
LEVELS: tuple[Level, ...] = ("trouble", "look", "note")
"""'trouble': figures are wrong or missing now; 'look': they will be, or somebody should look; 'note': good to know."""
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
    mend: str


def alarms(look: Look) -> tuple[Alarm, ...]:
    """Everything that is wrong, the worst first. Where there is no contact, that is the one thing to say."""
    if not look.in_contact:
        return _no_contact(look)
    found = [*_aggregator(look), *_cameras(look), *_regressors(look), *_stalled(look), *_sight(look), *_coverage(look)]
    return tuple(sorted(found, key=lambda alarm: LEVELS.index(alarm.level))[:MAX_ALARMS])


def _no_contact(look: Look) -> tuple[Alarm, ...]:
    if look.final and look.heard_s is not None:
        text = f"The load is complete. The line said so last {span(look.heard_s)} ago and has been off since."
        return (Alarm("off", "note", text, "Nothing needs to be done."),)
    since = "" if look.heard_s is None else f" for {span(look.heard_s)}"
    text = f"No contact with line {look.line}{since}." + (f" {look.trouble}." if look.trouble else "")
    mend = "The line may still be counting. See that its computer is on and the network cable is plugged in."
    return (Alarm("no-contact", "trouble", text, mend),)


def _aggregator(look: Look) -> Iterator[Alarm]:
    node = look.role("aggregator").get("aggregator")
    if look.totals is None:
        if node is None or node.state == "gone":
            yield Alarm(
                "no-aggregator",
                "trouble",
                "Nobody keeps the ledger: the aggregator is not there.",
                "Start it. Cameras keep what they count on their own disk until it is back.",
            )
        return
    if look.totals_age_s > STALE_S and not look.final:
        yield Alarm(
            "totals-old",
            "trouble",
            f"The load has not been told for {span(look.totals_age_s)}: the figures are old.",
            "Start the aggregator again. Cameras keep what they count on their own disk until it is back.",
        )
    if node is not None:
        for counter, text in AGGREGATOR_REFUSALS.items():
            if counter in node.growing_s:
                yield Alarm(counter, "trouble", text, AGGREGATOR_MEND)


def _cameras(look: Look) -> Iterator[Alarm]:
    for name in look.camera_names():
        for key, serious, text, mend in camera_alarms(name, look):
            yield Alarm(f"camera-{name}-{key}", "trouble" if serious else "look", text, mend)


def _regressors(look: Look) -> Iterator[Alarm]:
    nodes = look.role("regressor")
    segmenters = look.role("segmenter").values()
    waiting = sum(int(node.level("views_outstanding") or 0) for node in segmenters if node.alive)
    if not any(node.alive for node in nodes.values()) and segmenters and not look.final:
        yield Alarm(
            "no-regressor",
            "trouble" if waiting or nodes else "note",
            f"Nobody weighs: no regressor is there, {waiting} views wait.",
            "Start a regressor on any computer of the line. Tubers are counted; their weights come when it is there.",
        )
    for name, node in nodes.items():
        if node.state == "gone" and node.away_s < LEFT_NOTED_S and not look.final:
            yield Alarm(
                f"regressor-{name}-left",
                "note",
                f"Regressor {name} left {span(node.away_s)} ago; the others took over its work.",
                "If that was not wanted, look at its computer.",
            )
        if "views_refused_not_finite" in node.growing_s:
            yield Alarm(
                f"regressor-{name}-refuses",
                "look",
                f"Regressor {name} gets views that cannot be weighed.",
                "Read its log; look at the cameras' pictures.",
            )


def _stalled(look: Look) -> Iterator[Alarm]:
    for name, node in sorted(look.nodes.items()):
        if node.state == "stalled":
            host = node.report.host if node.report else "its computer"
            yield Alarm(
                f"stalled-{name}", "trouble", f"{name} on {host} hangs.", "Restart it; read its log to see what it did."
            )
        waiting = node.level("log_uncommitted")
        if node.alive and waiting is not None and waiting > UNCOMMITTED and not look.final:
            yield Alarm(
                f"uncommitted-{name}",
                "look",
                f"{waiting:.0f} entries of {name} wait for the ledger; they are safe on its disk.",
                "Look at the aggregator and its disk.",
            )


def _sight(look: Look) -> Iterator[Alarm]:
    totals = look.totals
    if totals is not None and totals.state == "nothing seen":
        mend = "Look at the cameras' pictures and their logs; this is no empty load."
        yield Alarm("nothing-seen", "trouble", f"Nothing was seen: {totals.reason}.", mend)
    elif totals is not None and totals.state == "starting":
        mend = "Wait, or see why it does not come."
        yield Alarm("starting", "look", f"Starting, not counting: {totals.reason}.", mend)


def _coverage(look: Look) -> Iterator[Alarm]:
    totals = look.totals
    if totals is None or totals.coverage is None or totals.count < ENOUGH_TUBERS:
        return
    if totals.coverage < LITTLE_COVERAGE:
        yield Alarm(
            "coverage",
            "look",
            f"{100 * (1 - totals.coverage):.1f} % of the belt was not looked at. The estimate makes up for it.",
            "See which camera dropped frames or was away, below.",
        )
