"""Tickets: what a scale said of tubers that were counted and weighed; the file that keeps them.

Three kinds stand in one file: a load (a trailer on a weighbridge), a bucket (a part of a run on a small scale) and
tubers (single weights in belt order). `aggregator.calibration.correction` makes one correction of all of them.
A ticket holds for the weights (model) that weighed its tubers and no other.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from aggregator.calibration.part import Part
from aggregator.calibration.sensitivity import TYPICAL_PER_MM
from aggregator.ledger.files import write_whole
from conveyor.errors import InputError
from conveyor.text_files import read_json

RATIO_RANGE = (0.75, 1.35)
"""A ticket outside of it is of other tubers, in other units, or the line did not see most of the belt."""

LEAST_COVERAGE = 0.8
MOST_SCALE_SD = 0.2
"""Of the weight; an error above it was given in other units, and its ticket would say nothing."""
MOSTLY = 0.5
"""Of the tubers of two tickets: fewer in common leave each to say something of its own."""
KINDS = ("load", "bucket", "tubers")
FORMAT = 2
OLD_FORMAT = 1
"""Of version 0.1: loads alone, without their outline."""


@dataclass(frozen=True, slots=True)
class Single:
    """One tuber that met the scale.

    Attributes:
        scale_g: what the scale said. weighed_g, sd_g: what Tuberline said, and its standard deviation.
        per_mm_g: by how much that grows for each millimetre that the tuber lies lower than stated.
    """

    tuber_id: int
    scale_g: float
    weighed_g: float
    sd_g: float
    per_mm_g: float


@dataclass(frozen=True, slots=True)
class Ticket:
    """Tubers that met a scale.

    Attributes:
        run: of the ledger; a tuber of it counts once in each kind.
        model: weights that weighed it, name@digest.
        ticket_g, ticket_sd_g: what the scale said, net, and its standard deviation.
        estimated_g, estimated_sd_g: what Tuberline said before any calibration, for the whole belt, and its random
            error alone.
        coverage: share of the belt that was looked at.
        kind: one of `KINDS`. part: of the run, '' for all of it.
        tubers: how many were counted; 0 in tickets of version 0.1.
        per_mm_g: by how much `estimated_g` grows for each millimetre that tubers lie lower than stated.
        stated_offset_mm: resting offset that the run was weighed with.
        cultivar: '' where none was named. singles: of kind 'tubers'.
        set_aside: why it is not used; '' where it is.
    """

    run: str
    model: str
    ticket_g: float
    ticket_sd_g: float
    estimated_g: float
    estimated_sd_g: float
    coverage: float
    kind: str = "load"
    part: str = ""
    tubers: int = 0
    per_mm_g: float = 0.0
    stated_offset_mm: float = 0.0
    cultivar: str = ""
    singles: tuple[Single, ...] = ()
    set_aside: str = ""

    @property
    def key(self) -> tuple[str, str, str]:
        """What a ticket is of; there is one ticket of each."""
        return self.kind, self.run, self.part

    @property
    def name(self) -> str:
        """The key in words."""
        return f"{self.kind} of run {self.run}{f', {self.part}' if self.part else ''}"

    @property
    def sd(self) -> float:
        """Random error of the ticket over the estimate, as a share."""
        return math.hypot(self.ticket_sd_g / self.ticket_g, self.estimated_sd_g / self.estimated_g)

    @property
    def grams_per_mm(self) -> float:
        """`per_mm_g`, or what is typical of a load whose outlines are not known (tickets of version 0.1)."""
        return self.per_mm_g or TYPICAL_PER_MM * self.estimated_g


def check_ticket(ticket: Ticket) -> Ticket:
    """The ticket, if it can be one of this load.

    Raises:
        InputError: it cannot; the text says which figure is off and what to look for.
    """
    if ticket.kind not in KINDS:
        raise InputError(f"a ticket of run {ticket.run} is of kind {ticket.kind!r}; known: {', '.join(KINDS)}")
    if not (math.isfinite(ticket.ticket_g) and ticket.ticket_g > 0):
        raise InputError(f"the ticket says {ticket.ticket_g / 1000:g} kg: give the load's net weight, above 0 kg")
    if not (math.isfinite(ticket.ticket_sd_g) and ticket.ticket_sd_g >= 0):
        raise InputError(f"the scale's error is {ticket.ticket_sd_g / 1000:g} kg: give 0 kg or more")
    if not math.isfinite(ticket.stated_offset_mm):
        raise InputError(f"the resting offset of run {ticket.run} is {ticket.stated_offset_mm:g} mm: give a number")
    if ticket.estimated_g <= 0:
        raise InputError(f"{ticket.name} counted no tuber: there is nothing to calibrate")
    if ticket.coverage < LEAST_COVERAGE:
        # Rounded down: 79.7 % are not the 80 that it takes. Tubers of no belt are of one that is not known.
        share = f"{math.floor(1000 * ticket.coverage) / 10:g} % of the belt were looked at"
        seen = share if ticket.coverage else "how much of its belt was looked at is not known"
        raise InputError(
            f"{ticket.name}: {seen}, a ticket needs at least {100 * LEAST_COVERAGE:.0f} %: calibrate with a load that "
            "was seen whole"
        )
    ratio = ticket.ticket_g / ticket.estimated_g
    low, high = RATIO_RANGE
    if not low <= ratio <= high:
        raise InputError(
            f"the ticket says {ticket.ticket_g / 1000:.1f} kg, {ticket.name} came to {ticket.estimated_g / 1000:.1f} "
            f"kg: a ratio of {ratio:.2f}, allowed is {low} to {high}; is it the same load, net, in kilograms?"
        )
    if (ticket.kind == "tubers") != bool(ticket.singles):
        raise InputError(f"{ticket.name}: single weights belong to kind 'tubers', and to no other")
    if not all(0 < value < math.inf for one in ticket.singles for value in (one.scale_g, one.weighed_g, one.sd_g)):
        raise InputError(f"{ticket.name}: every single weight and its standard deviation must be above 0 g")
    return ticket


def check_scale(ticket: Ticket) -> Ticket:
    """The ticket, if its scale's error can be one; asked of new tickets alone, so that files go on being read.

    Raises:
        InputError: it is more than `MOST_SCALE_SD` of the weight.
    """
    if ticket.ticket_sd_g > MOST_SCALE_SD * ticket.ticket_g:
        raise InputError(
            f"the scale's error is {ticket.ticket_sd_g / 1000:g} kg of {ticket.ticket_g / 1000:g} kg ({ticket.name}): "
            f"more than {100 * MOST_SCALE_SD:.0f} % says nothing; give its standard deviation in kilograms, of single "
            "weights that of one in grams"
        )
    return ticket


def with_ticket(tickets: Sequence[Ticket], ticket: Ticket, *, again: bool) -> tuple[Ticket, ...]:
    """`tickets` with one more; no tuber is in two tickets of a kind, else what a scale said of it counts twice.

    Raises:
        InputError: some of its tubers have one already, or may (one part goes by numbers, the other by places), and
            `again`, which replaces it, is not given; or its scale cannot be as bad as it says.
    """
    check_scale(ticket)
    of_same = [known for known in tickets if same_tubers(known, ticket) is not False]
    if of_same and not again:
        found = of_same[0]
        if found.key == ticket.key:
            raise InputError(f"{ticket.name} has a ticket already; give --again to replace it")
        it = "it" if len(of_same) == 1 else "them"
        if same_tubers(found, ticket) is None:
            raise InputError(
                f"{ticket.name} and the ticket {found.name} may hold the same tubers, which would count twice: name "
                "both by numbers or both by places (the run's tubers.csv has the two side by side), or give --again to "
                f"replace {it}"
            )
        raise InputError(
            f"{ticket.name} and the ticket {found.name} hold the same tubers, which would count twice; name the part "
            f"that none was weighed of before, or give --again to replace {it}"
        )
    return (*(known for known in tickets if known not in of_same), ticket)


def same_tubers(one: Ticket, other: Ticket) -> bool | None:
    """Of a kind and a run, and the same or overlapping parts of it; a whole run holds all of its loads. None where it
    cannot be told.
    """
    if one.key == other.key:
        return True
    if (one.kind, one.run) != (other.kind, other.run):
        return False
    if "" in (one.part, other.part):
        return True
    parts = Part.named(one.part), Part.named(other.part)
    return parts[0].overlaps(parts[1]) if parts[0] is not None and parts[1] is not None else False


def of_same_tubers(tickets: Sequence[Ticket], ticket: Ticket) -> list[Ticket]:
    """Those of other kinds that are mostly of the tubers of `ticket`, as far as parts tell: each counts in full, as if
    it were of others, and the interval comes out too narrow.
    """
    return [
        known
        for known in tickets
        if (known.run, known.model) == (ticket.run, ticket.model)
        and known.kind != ticket.kind
        and not (known.set_aside or ticket.set_aside)
        and same_tubers(replace(known, kind=ticket.kind), ticket)
        and min(known.tubers, ticket.tubers) >= MOSTLY * max(known.tubers, ticket.tubers)
    ]


def set_aside(
    tickets: Sequence[Ticket], run: str, *, kind: str | None, reason: str, part: str | None = None
) -> tuple[Ticket, ...]:
    """`tickets` with the one of `run` set aside for a reason, or back in use for the reason ''.

    Raises:
        InputError: none of that run, or several kinds or parts of it.
    """
    chosen = [
        ticket
        for ticket in tickets
        if ticket.run == run and kind in (None, ticket.kind) and part in (None, ticket.part)
    ]
    if len(chosen) != 1:
        known = "; ".join(ticket.name for ticket in chosen or tickets) or "none"
        many, of_part = "several tickets" if chosen else "no ticket", f", part {part!r}" if part is not None else ""
        raise InputError(
            f"{many} of {kind or 'any kind'} of run {run!r}{of_part}; choose by --run, --kind, --part among: {known}"
        )
    return tuple(replace(ticket, set_aside=reason) if ticket is chosen[0] else ticket for ticket in tickets)


def read_tickets(path: Path) -> tuple[Ticket, ...]:
    """The tickets in the JSON file at `path`, of this format or that of version 0.1.

    Raises:
        InputError: unreadable, of another format, with a ticket that cannot be one, or with two of the same.
    """
    raw = read_json(path, what="tickets")
    version = raw.get("format") if isinstance(raw, dict) else None
    if version not in (OLD_FORMAT, FORMAT) or not isinstance(raw.get("tickets"), list):
        raise InputError(
            f'tickets {path}: want {{"format": {FORMAT}, "tickets": [...]}} as `tuberline calibrate` writes it; this '
            f"version reads formats {OLD_FORMAT} and {FORMAT}"
        )
    names = tuple(Ticket.__dataclass_fields__)[: 7 if version == OLD_FORMAT else None]
    found = [_ticket(item, names, f"tickets {path}: ticket {n}") for n, item in enumerate(raw["tickets"])]
    first: dict[tuple[str, str, str], int] = {}
    for n, ticket in enumerate(found if version == FORMAT else ()):
        if first.setdefault(ticket.key, n) < n:
            raise InputError(
                f"tickets {path}: ticket {n} is of {ticket.name}, as ticket {first[ticket.key]} is: the scale would "
                "count twice; keep one of the two"
            )
    return tuple(found)


_TEXTS = ("run", "model", "kind", "part", "cultivar", "set_aside")
_SIGNED = ("stated_offset_mm",)


def _ticket(item: Any, names: Sequence[str], where: str) -> Ticket:
    values = _values(item, names, where)
    singles = values.pop("singles", [])
    if not isinstance(singles, list):
        raise InputError(f"{where}: singles must be a list")
    fields = tuple(Single.__dataclass_fields__)
    found = [_values(one, fields, f"{where}: single {n}") for n, one in enumerate(singles)]
    ids = [{**one, "tuber_id": int(one["tuber_id"])} for one in found]
    if "tubers" in values:
        values["tubers"] = int(values["tubers"])
    return check_ticket(replace(_EMPTY, **values, singles=tuple(replace(_NONE, **one) for one in ids)))


_EMPTY, _NONE = Ticket("", "", 0, 0, 0, 0, 0), Single(0, 0, 0, 0, 0)


def _values(item: Any, names: Sequence[str], where: str) -> dict[str, Any]:
    if not isinstance(item, dict) or set(item) != set(names):
        raise InputError(f"{where} must have exactly {', '.join(names)}")
    for name, value in item.items():
        if name in _TEXTS:
            if not isinstance(value, str):
                raise InputError(f"{where}: {name} is {value!r}, must be a text")
        elif name != "singles":
            number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
            if not number or (value < 0 and name not in _SIGNED):
                raise InputError(f"{where}: {name} is {value!r}, must be a number of at least 0")
    return dict(item)


def write_tickets(path: Path, tickets: Sequence[Ticket]) -> None:
    """Write all tickets, whole or not at all."""
    text = json.dumps({"format": FORMAT, "tickets": [asdict(ticket) for ticket in tickets]}, indent=2)
    write_whole(path, text + "\n")
