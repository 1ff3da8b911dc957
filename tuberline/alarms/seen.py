"""What of a line is worth an alarm: the page's own alarms, a limit on coverage, lost regressors, disks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set

from conveyor.config import LineConfig
from tuberline.alarms.machine import Seen
from tuberline.alarms.message import AlarmMessage
from tuberline.doctor.finding import Finding, Level
from viewer.page.alarms import ENOUGH_TUBERS, LEVELS, alarms
from viewer.page.state import LineState
from viewer.page.words import span

MOST_SEEN = 512
NO_CONTACT = "no-contact"
DISK = "disk-"
ALL_REGRESSORS = "regressor/"
FORGOTTEN_AFTER_S = 600.0
"""Regressors of containers have a new name at each start: one that is in no config and long gone is no alarm."""


def seen_alarms(state: LineState, config: LineConfig, disks: Sequence[Finding]) -> list[Seen]:
    """Everything that is wrong and bad enough."""
    assert config.alarms is not None
    enough = LEVELS.index(config.alarms.least)
    names = sorted({*state.camera_names(), *config.cameras}, key=len, reverse=True)
    found = [
        *_of_page(state, names),
        *(_lost_regressors(state, config) if state.in_contact and not (state.final or state.stopped) else ()),
        *_coverage(state, config.alarms.coverage_below),
        *_disks(disks),
    ]
    return [alarm for alarm in found if LEVELS.index(alarm.level) <= enough]


def unknown_keys(
    state: LineState, active: Mapping[str, AlarmMessage], expected: Set[str], *, disks_known: bool, unix_s: float
) -> frozenset[str]:
    """Of the alarms that are `active` (by key: their beginnings), those of which this look says nothing.

    Nothing is known of any without contact, and of those about one process until that process was heard of: who came
    after it had gone cannot see that it is gone. One that is not `expected` ('role/name', by the line's config) is
    waited for no longer than it is told of.
    """
    line_known = state.in_contact or state.final

    def known(key: str, begun: AlarmMessage) -> bool:
        if key.startswith(DISK):
            return disks_known
        if key == NO_CONTACT:
            return True
        about = _about(key, begun.camera)
        if not line_known or about is None or state.final:
            return line_known
        waited_for = about == ALL_REGRESSORS or about in expected
        forgotten = not waited_for and unix_s - begun.since_unix_s >= FORGOTTEN_AFTER_S
        return forgotten or _heard_of(about, state)

    return frozenset(key for key, begun in active.items() if not known(key, begun))


def _about(key: str, camera: str) -> str | None:
    """The process ('role/name') that an alarm is about; ALL_REGRESSORS where about all of them, None about none."""
    head, _, rest = key.partition("-")
    if key == "no-regressor":
        return ALL_REGRESSORS
    if head == "regressor":
        return f"regressor/{rest.rpartition('-')[0]}"
    if head in ("stalled", "uncommitted"):
        return rest
    if head == "camera" and camera and (what := key.removeprefix(f"camera-{camera}-")) not in ("heights", "exchanged"):
        return f"camera/{camera}" if what in ("camera-gone", "camera-quiet") else f"segmenter/{camera}"
    return None


def _heard_of(about: str, state: LineState) -> bool:
    """Of that process, or of one of that role, more is known than that it is starting."""
    heard = [name for name, node in state.nodes.items() if node.state != "starting"]
    return about in heard or (about == ALL_REGRESSORS and any(name.startswith(about) for name in heard))


def _of_page(state: LineState, names: Sequence[str]) -> Iterator[Seen]:
    for alarm in alarms(state, most=MOST_SEEN):
        if alarm.key == "coverage" or (alarm.key.startswith("regressor-") and alarm.key.endswith("-left")):
            continue  # told below, with a limit and for as long as it lasts
        yield Seen(alarm.key, alarm.level, alarm.text, alarm.fix, _camera(alarm.key, names))


def _camera(key: str, names: Sequence[str]) -> str:
    heads = ("camera-{}-", "stalled-camera/{}", "stalled-segmenter/{}", "uncommitted-segmenter/{}")
    for name in names:
        for head in heads:
            wanted = head.format(name)
            if key == wanted or (head.endswith("-") and key.startswith(wanted)):
                return name
    return ""


def _lost_regressors(state: LineState, config: LineConfig) -> Iterator[Seen]:
    own = {*(f"r{n}" for n in range(1, config.regressor.processes + 1)), *config.access.regressors}
    others = any(not node.left and node.state != "silent" for node in state.role("regressor").values())
    for name, node in state.role("regressor").items():
        if node.left and (name in own or node.away_s < FORGOTTEN_AFTER_S):
            yield Seen(
                f"regressor-{name}-lost",
                "warning",
                f"Regressor {name} is gone{'; the others take over its work' if others else ''}.",
                "Look at its computer and its log; start it again.",
            )
        elif node.state == "silent":
            yield Seen(
                f"regressor-{name}-quiet",
                "warning",
                f"Regressor {name} says nothing.",
                "Look at its computer and the network; start it again.",
            )


def _coverage(state: LineState, limit: float) -> Iterator[Seen]:
    totals = state.totals
    if totals is not None and totals.belt_unknown:
        yield Seen(
            f"coverage-{totals.run}",
            "warning",
            f"How much of this load's belt was looked at is not known: {totals.reason}.",
            "Free the computer for more frames a second, or connect an encoder.",
        )
    if totals is None or totals.coverage is None or totals.count < ENOUGH_TUBERS or totals.coverage >= limit:
        return
    if not (state.in_contact or state.final):
        return
    yield Seen(
        f"coverage-{totals.run}",
        "warning",
        f"Only {100 * totals.coverage:.1f} % of this load's belt was looked at; the limit is {100 * limit:g} %.",
        "See on the page which camera dropped frames or was away.",
    )


def _disks(findings: Sequence[Finding]) -> Iterator[Seen]:
    for finding in findings:
        if finding.level is not Level.OK:
            level = "trouble" if finding.level is Level.FAULT else "warning"
            yield Seen(f"{DISK}{finding.check}", level, f"The {finding.check}: {finding.text}.", finding.fix)


def disk_stands_still(seconds: float) -> Finding:
    """The finding where a look at the disks does not come back."""
    fix = "see the kernel's log (dmesg); a disk that fails must be replaced"
    return Finding("disks", Level.FAULT, f"a file could not be written for {span(seconds)}", fix)
