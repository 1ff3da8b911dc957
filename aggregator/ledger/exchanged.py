"""Is a camera still the one that was calibrated? By what it says of itself, in this run and in those before it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from aggregator.calibration.tickets import Ticket
from aggregator.core.device import Device, with_newest
from aggregator.core.loads import Load
from aggregator.core.sight import CameraSight
from aggregator.ledger.reader import RunRow, read_runs, read_sums
from aggregator.ledger.verified import LedgerView
from conveyor.messages import CameraExchanged

RUNS_BACK = 32
"""Runs before this one that are asked: what was exchanged longer ago is told no more."""


def devices_before(view: LedgerView, run: str) -> dict[str, list[Device]]:
    """By camera, the devices that it had in the runs before `run`, oldest first; those that followed each other and
    did not differ are one.
    """
    runs = [known.run for known in read_runs(view)]
    earlier = runs[: runs.index(run)] if run in runs else runs
    found: dict[str, list[Device]] = {}
    for name in earlier[-RUNS_BACK:]:
        for camera, sight in read_sums(view, name).sights.items():
            found[camera] = _chain([*found.get(camera, ()), *sight.published.devices])
    return found


def cameras_exchanged(
    sights: Mapping[str, CameraSight],
    before: Mapping[str, Sequence[Device]],
    tickets: Callable[[], Sequence[Ticket]],
    *,
    loads: Mapping[int, Load],
    runs: Callable[[], Sequence[RunRow]],
) -> tuple[CameraExchanged, ...]:
    """The cameras that are not what they were, by name.

    One is told of in the run in which it changed, and after it as long as tickets from before calibrate; in both until
    there is a ticket from after the change.

    Args:
        sights: what the cameras looked at in this run; before: as by `devices_before`.
        tickets: tells all that calibrate. loads, runs: of the ledger, by which a ticket's time is known.
    """
    found = []
    for camera, sight in sorted(sights.items()):
        own = sight.published.devices
        known = _chain([*before.get(camera, ()), *own])
        if not own or len(known) < 2:
            continue
        (former, now), begun = known[-2:], runs()
        later = [_is_later(ticket, now.since_ns, loads, begun) for ticket in tickets() if not ticket.set_aside]
        if not any(later) and (later or now in own):
            found.append(CameraExchanged(camera, former.told, now.told, now.since_ns))
    return tuple(found)


def _chain(devices: Iterable[Device]) -> list[Device]:
    chain: list[Device] = []
    for device in devices:
        chain = with_newest(chain, device)
    return chain


def _is_later(ticket: Ticket, since_ns: int, loads: Mapping[int, Load], runs: Sequence[RunRow]) -> bool:
    """What it weighed passed after `since_ns`; of a run that the ledger does not hold nothing is known."""
    for load in loads.values():
        if ticket.key == ("load", load.run, f"load {load.number}"):
            return load.began_ns >= since_ns
    return any(run.run == ticket.run and run.started_ns >= since_ns for run in runs)
