"""From a run in the ledger, or a part of it, and what the scale said of it to a ticket."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from aggregator.calibration.align import Alignment, align
from aggregator.calibration.correction import sink_mm, stated_mm
from aggregator.calibration.part import Part
from aggregator.calibration.sensitivity import tuber_g_per_mm
from aggregator.calibration.tickets import Single, Ticket, check_ticket
from aggregator.core.loads import SAME_OFFSET_MM
from aggregator.core.totals import LoadTotals
from aggregator.ledger.reader import (
    coverage_of,
    ledger_file,
    moment_of,
    read_sums,
    read_tubers,
    reading,
    run_being_written,
    the_run,
)
from aggregator.ledger.stated import belt_of_run, stated_beside
from conveyor.errors import InputError
from conveyor.messages import Tuber
from conveyor.statistics import NORMAL_90

LEAST_SHARE = 0.95
"""Of a load's weight that one set of weights must have weighed: its ticket says nothing about any other."""

MISCOUNTED = 0.002
"""Share of tubers that counting may miss or count twice where no one counted by hand."""

MOST_MISCOUNTED = 0.1
LEAST_SD = 0.01
"""Of a tuber's weight: a ledger's interval is never narrower."""


@dataclass(frozen=True, slots=True)
class Counted:
    """What a run counted: its id, its tubers in the order they crossed, and what the totals make of the whole belt.

    `unshared_sd_g` is the random error of belt that was not looked at and of what lies under others.
    `stated_offset_mm`: resting offset that it was weighed with, on a web with the `sink_mm` of an ordinary tuber; None
    where neither its summary nor a config beside the ledger says.
    """

    run: str
    tubers: tuple[Tuber, ...]
    coverage: float
    estimated_g: float
    unshared_sd_g: float
    stated_offset_mm: float | None = None
    sink_mm: float = 0.0


def counted(path: Path, *, run: str | None) -> Counted:
    """The run in the folder (or ledger) `path`.

    Raises:
        LedgerError: no ledger, or not that run.
    """
    ledger = ledger_file(path)
    with reading(ledger) as view:
        chosen = the_run(view, ledger, run)
        sums = read_sums(view, chosen.run)
        tubers = tuple(read_tubers(view, chosen.run))
        belt = belt_of_run(view, chosen.run, sums, stated_beside(ledger))
        seen = coverage_of(chosen, sums, moment_of(chosen, run_being_written(view)))
    load = LoadTotals(sums.load)
    coverage = seen.share or 0.0
    estimated_g, _, _ = load.estimated(coverage, belt_m=seen.belt_m)
    # What is random from load to load; the bias that all tubers share is what the ticket is to measure.
    random_sd_g = load.unshared_sd_g(coverage, belt_m=seen.belt_m)
    ordered = tuple(sorted(tubers, key=lambda tuber: (tuber.crossed_ns, tuber.tuber_id)))
    offset_mm = None if belt is None else stated_mm(belt)
    return Counted(chosen.run, ordered, coverage, estimated_g, random_sd_g, offset_mm, sink_mm(belt or {}))


def ticket_of(
    path: Path,
    *,
    run: str | None,
    ticket_g: float,
    ticket_sd_g: float,
    cultivar: str = "",
    stated_offset_mm: float | None = None,
) -> Ticket:
    """The ticket of a whole load: the run in the folder (or ledger) `path`.

    Args:
        stated_offset_mm: resting offset that the run was weighed with, where its ledger does not say.

    Raises:
        LedgerError: no ledger, or not that run. InputError: the load cannot be calibrated with; the text says why.
    """
    found = counted(path, run=run)
    whole = 1.0 / max(found.coverage, 1e-9)
    own_sd_g = whole * math.hypot(_own_sd_g(found.tubers), _miscounted_sd_g(found.tubers, None))
    return check_ticket(
        Ticket(
            found.run,
            _model_of(found.tubers, found.run),
            ticket_g,
            ticket_sd_g,
            found.estimated_g,
            math.hypot(own_sd_g, found.unshared_sd_g),
            found.coverage,
            tubers=len(found.tubers),
            per_mm_g=whole * sum(map(tuber_g_per_mm, found.tubers)),
            stated_offset_mm=_stated_mm(found, stated_offset_mm),
            cultivar=cultivar,
        )
    )


def bucket_ticket(
    path: Path,
    *,
    run: str | None,
    part: Part,
    ticket_g: float,
    ticket_sd_g: float,
    count: int | None = None,
    cultivar: str = "",
    stated_offset_mm: float | None = None,
) -> tuple[Ticket, tuple[Tuber, ...]]:
    """(ticket of tubers that passed and were weighed together, those tubers in belt order).

    Args:
        count: how many were in the bucket by hand; the sum of those seen is scaled to it.
        stated_offset_mm: as in `ticket_of`.

    Raises:
        LedgerError: no ledger, or not that run. InputError: the count is another, or the figures cannot be these.
    """
    found = counted(path, run=run)
    tubers = _some(found, part)
    # Of a whole run that no one counted by hand, belt that was not seen is made up for as in a load.
    whole_run = count is None and not part.name
    coverage = found.coverage if whole_run else 1.0
    scale = 1.0 / max(coverage, 1e-9) if whole_run else _count_scale(tubers, count, found.run)
    weighed_g = scale * sum(tuber.weight_g for tuber in tubers)
    ticket = check_ticket(
        Ticket(
            found.run,
            _model_of(tubers, found.run),
            ticket_g,
            ticket_sd_g,
            weighed_g,
            math.hypot(
                scale * _own_sd_g(tubers), _miscounted_sd_g(tubers, count), found.unshared_sd_g if whole_run else 0.0
            ),
            coverage,
            kind="bucket",
            part=part.name,
            tubers=len(tubers),
            per_mm_g=scale * sum(map(tuber_g_per_mm, tubers)),
            stated_offset_mm=_stated_mm(found, stated_offset_mm),
            cultivar=cultivar,
        )
    )
    return ticket, tubers


def singles_ticket(
    path: Path,
    *,
    run: str | None,
    part: Part,
    scale_g: Sequence[float],
    scale_sd_g: float,
    cultivar: str = "",
    stated_offset_mm: float | None = None,
) -> tuple[Ticket, Alignment, tuple[Tuber, ...]]:
    """(ticket of single weights in belt order, how they were laid beside the tubers, those tubers in belt order).

    Args:
        stated_offset_mm: as in `ticket_of`.

    Raises:
        LedgerError: no ledger, or not that run. InputError: the weights are not of these tubers in this order.
    """
    found = counted(path, run=run)
    tubers = _some(found, part)
    laid = align(scale_g, [tuber.weight_g for tuber in tubers])
    singles = []
    for i, j in laid.pairs:
        tuber = tubers[j]
        sd_g = math.hypot(_tuber_sd_g(tuber), scale_sd_g * tuber.weight_g / scale_g[i])
        singles.append(Single(tuber.tuber_id, scale_g[i], tuber.weight_g, sd_g, tuber_g_per_mm(tuber)))
    paired = [tubers[j] for _, j in laid.pairs]
    ticket = Ticket(
        found.run,
        _model_of(paired, found.run),
        sum(one.scale_g for one in singles),
        scale_sd_g * math.sqrt(len(singles)),
        sum(one.weighed_g for one in singles),
        _own_sd_g(paired),
        1.0,
        kind="tubers",
        part=part.name,
        tubers=len(singles),
        per_mm_g=sum(one.per_mm_g for one in singles),
        stated_offset_mm=_stated_mm(found, stated_offset_mm),
        cultivar=cultivar,
        singles=tuple(singles),
    )
    return check_ticket(ticket), laid, tubers


def _stated_mm(found: Counted, given: float | None) -> float:
    """The resting offset that a run was weighed with: its own, else the one given, else none."""
    own = found.stated_offset_mm
    if own is not None and given is not None and abs(own - found.sink_mm - given) > SAME_OFFSET_MM:
        raise InputError(
            f"run {found.run} was weighed with a resting offset of {own - found.sink_mm:g} mm, --resting-offset-mm "
            f"says {given:g}: leave it out, the ticket takes what the run states"
        )
    return own if own is not None else given or 0.0


def _some(found: Counted, part: Part) -> tuple[Tuber, ...]:
    tubers = tuple(tuber for tuber in found.tubers if part.holds(tuber) and tuber.weight_g > 0)
    if not tubers:
        raise InputError(
            f"run {found.run} counted {len(found.tubers)} tubers, none of them among {part.name or 'all'}: see its "
            "tubers.csv for ids and places"
        )
    ids = [tuber.tuber_id for tuber in found.tubers]
    for option, given in (("--first", part.first), ("--last", part.last)):
        if given is not None and not min(ids) <= given <= max(ids):
            raise InputError(
                f"{option} is {given}, run {found.run} counted {len(ids)} tubers, numbered {min(ids)} to {max(ids)}: "
                "give one of these (id in its tubers.csv), or leave it out for the end of the run"
            )
    return tubers


def _count_scale(tubers: Sequence[Tuber], count: int | None, run: str) -> float:
    if count is None:
        return 1.0
    if abs(count - len(tubers)) > max(1.0, MOST_MISCOUNTED * len(tubers)):
        raise InputError(
            f"the bucket held {count} tubers, run {run} counted {len(tubers)} in that part: more than "
            f"{100 * MOST_MISCOUNTED:.0f} % apart. Name the part that the bucket is of (--first, --last or --from-x, "
            "--to-x)"
        )
    return count / len(tubers)


def _tuber_sd_g(tuber: Tuber) -> float:
    return max((tuber.high_g - tuber.low_g) / (2 * NORMAL_90), LEAST_SD * tuber.weight_g)


def _own_sd_g(tubers: Sequence[Tuber]) -> float:
    return math.sqrt(sum(_tuber_sd_g(tuber) ** 2 for tuber in tubers))


def _miscounted_sd_g(tubers: Sequence[Tuber], count: int | None) -> float:
    """Of the sum, by tubers that were missed or counted twice; a count by hand leaves the weights of those unknown."""
    if not tubers:
        return 0.0
    mean_square_g2 = sum(tuber.weight_g**2 for tuber in tubers) / len(tubers)
    wrong = MISCOUNTED * len(tubers) if count is None else abs(count - len(tubers))
    return math.sqrt(wrong * mean_square_g2)


def _model_of(tubers: Sequence[Tuber], run: str) -> str:
    shares: dict[str, float] = {}
    for tuber in tubers:
        shares[tuber.model] = shares.get(tuber.model, 0.0) + tuber.weight_g
    model = max(shares, key=lambda name: shares[name], default="")
    if shares and (not model or shares[model] < LEAST_SHARE * sum(shares.values())):
        told = ", ".join(f"{name or 'visible volume'} {grams / 1000:.1f} kg" for name, grams in sorted(shares.items()))
        raise InputError(
            f"run {run} was weighed by several: {told}; a ticket needs a load of which one set of weights weighed at "
            f"least {100 * LEAST_SHARE:.0f} %"
        )
    return model
