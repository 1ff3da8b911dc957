"""What the commands of `tuberline calibrate` say after a ticket: the correction, its worth, and who contradicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from aggregator.calibration.correction import Correction
    from aggregator.calibration.learning import Learning
    from aggregator.calibration.leave_one_out import LeftOut
    from aggregator.calibration.tickets import Ticket


def as_json(known: Sequence[Ticket], ticket: Ticket, learning: Learning | None = None) -> dict[str, Any]:
    """The ticket, the factor for a typical load, and the correction; of the tubers weighed before their camera was
    known, how many.
    """
    from aggregator.calibration.apply import load_factor
    from aggregator.calibration.correction import Prior
    from aggregator.calibration.leave_one_out import contradicting
    from aggregator.calibration.robust import correction_of
    from aggregator.calibration.tickets import of_same_tubers

    offset_mm = ticket.stated_offset_mm
    prior = Prior(stated_offset_mm=offset_mm)
    found = load_factor(known, ticket.model, prior, cultivar=ticket.cultivar)
    correction = correction_of(known, ticket.model, prior, cultivar=ticket.cultivar)
    against = contradicting(known, ticket.model, stated_offset_mm=offset_mm)
    return {
        "ticket": asdict(ticket),
        "load_factor": asdict(found) if found else None,
        "correction": correction_values(correction),
        "contradicting": [entry.ticket.name for entry in against],
        "of_same_tubers": [other.name for other in of_same_tubers(known, ticket)],
        "before_camera_known": learning.before if learning else 0,
    }


def correction_values(correction: Correction) -> dict[str, Any]:
    """A correction as plain values: means and 90 % half-widths."""
    from conveyor.statistics import NORMAL_90

    values: dict[str, tuple[float, float]] = {"offset_mm": correction.offset_mm, "factor": correction.factor}
    plain: dict[str, Any] = {
        name: {"mean": mean, "half_width_90": NORMAL_90 * sd} for name, (mean, sd) in values.items()
    }
    cultivars = {name: correction.cultivar_factor(name) for name in correction.cultivars if name}
    plain["cultivars"] = {
        name: {"mean": mean, "half_width_90": NORMAL_90 * sd} for name, (mean, sd) in cultivars.items()
    }
    return {**plain, "loads_differ_by": correction.load_sd, "tickets": dict(correction.used)}


def after_ticket(known: Sequence[Ticket], ticket: Ticket, path: Path, learning: Learning | None = None) -> str:
    """Lines for the terminal after a ticket was added."""
    from aggregator.calibration.apply import load_factor, told
    from aggregator.calibration.correction import Prior
    from aggregator.calibration.leave_one_out import contradicting
    from aggregator.calibration.robust import correction_of
    from aggregator.calibration.tickets import of_same_tubers

    offset_mm = ticket.stated_offset_mm
    prior = Prior(stated_offset_mm=offset_mm)
    found = load_factor(known, ticket.model, prior, cultivar=ticket.cultivar)
    correction = correction_of(known, ticket.model, prior, cultivar=ticket.cultivar)
    lines = [
        f"{ticket.name}: {ticket.estimated_g / 1000:.3f} kg estimated, {ticket.ticket_g / 1000:.3f} kg on the scale "
        f"(ratio {ticket.ticket_g / ticket.estimated_g:.3f})"
    ]
    if found:
        number = f"{found.tickets} ticket{'s' * (found.tickets > 1)}"
        lines += [
            f"{number} of {found.model}: {told(correction)}",
            f"totals of such loads are multiplied by {found.factor:.3f}, a load is then known to "
            f"{100 * found.half_width:.1f} %",
        ]
    lines += [_doubled(ticket, other, path) for other in of_same_tubers(known, ticket)]
    lines += [warning(entry, path) for entry in contradicting(known, ticket.model, stated_offset_mm=offset_mm)]
    lines += [learning.told] if learning else []
    lines.append(f'put tickets = "{path}" under [aggregator] of the line\'s file')
    return "\n".join(lines) + "\n"


def warning(entry: LeftOut, path: Path) -> str:
    """A ticket that contradicts, and what to do about it."""
    return f"{entry.told}. If it is wrong: {_set_aside(entry.ticket, path)}"


def _doubled(ticket: Ticket, other: Ticket, path: Path) -> str:
    """Two that are of the same tubers, and which of them to set aside."""
    return (
        f"{other.name} and {ticket.name} are of the same tubers, and each counts in full: a load is known less well "
        f"than is said. Keep the more precise one: {_set_aside(max(other, ticket, key=_vague), path)}"
    )


def _vague(ticket: Ticket) -> tuple[bool, float]:
    """Single weights tell more than any sum of them."""
    return not ticket.singles, ticket.sd


def _set_aside(ticket: Ticket, path: Path) -> str:
    part = f"--part '{ticket.part}' " if ticket.part else ""
    return f'tuberline calibrate set-aside {path} --run {ticket.run} --kind {ticket.kind} {part}--reason "..."'
