"""What is asked of the aggregator about loads, what it answers, and what the totals say of the load that is open."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from conveyor.messages.base import Message
from conveyor.messages.classes import ClassTotal
from conveyor.messages.foreign import ForeignTotal
from conveyor.messages.heights import HeightChange
from conveyor.ranges import BeltPlace, Count, Items, Line, LoadGrams, Name, Range, Text, Word, Yes
from conveyor.stated import SCALE_ERROR_KG, TICKET_KG

Told = Annotated[str, Text(256, r"^[^\x00-\x1f\x7f]*$")]
"""A name that a person gives: of a load, a field, a variety."""

FIELDS = ("name", "trailer", "field", "variety", "customer", "operator")
"""What a load is described by; an order may give each of them, a later note may correct it."""

NUMBER = "number:"
"""Before the number of a load, for one that may be another one's name."""


def number_meant(wanted: str) -> int | None:
    """The number of the load that is asked for, '3' or 'number:3'; None where `wanted` can only be a name."""
    digits = wanted.removeprefix(NUMBER)
    return int(digits) if digits.isascii() and digits.isdigit() and len(digits) < 19 else None


def is_meant(wanted: str, *, number: int, name: str) -> bool:
    """Whether the load of this number and name is among those that `wanted` may mean."""
    return number == number_meant(wanted) or name == wanted


@dataclass(frozen=True, slots=True)
class LoadOrder(Message):
    """Something to be done about a load.

    Attributes:
        request: id of this order, unique; the same again, after a lost answer say, is done once.
        action: 'start' a load (the open one ends there), 'end' the open one, 'note', 'ticket', 'undo' the last change.
        by: who asks, as the asker says it.
        age_s: since it was asked for, by the asker's clock: the belt has moved on meanwhile.
        load: which, by number (also after `NUMBER`) or name; '' is the open one, or the last one where none is open.
            With 'start': a load that ended and goes on.
        fields: of `FIELDS`, those given.
        note: what is to be remembered of it.
        kg: a scale's answer; None with 'ticket' withdraws the one before. net: of tubers alone, else with soil and
            stones.
        scale_error_kg: standard deviation of the scale; None: 0.5 %.
        place_x_m: where on the belt it changes, instead of what lies at the cameras' centre row now.
    """

    request: Name
    action: Literal["start", "end", "note", "ticket", "undo"]
    by: Told = ""
    age_s: Annotated[float, Range(0, 3600, "s")] = 0.0
    load: Told = ""
    fields: Annotated[dict[Literal["name", "trailer", "field", "variety", "customer", "operator"], Told], Items(8)] = (
        field(default_factory=dict)
    )
    note: Line = ""
    kg: Annotated[float, Range(*TICKET_KG, "kg")] | None = None
    net: Yes = True
    scale_error_kg: Annotated[float, Range(*SCALE_ERROR_KG, "kg")] | None = None
    place_x_m: BeltPlace | None = None


@dataclass(frozen=True, slots=True)
class LoadAnswer(Message):
    """What became of an order: done and durable in the ledger, or refused with the error in words.

    Attributes:
        load: number of the load it was about; 0 where refused. name: its name.
        text: what was done, in words. error: why not; '' where it was done.
        event: number under which the ledger has it; 0 where refused.
        place_x_m: where on the belt the load changed, where it did and that is a number.
        later: refused because of what will be known soon: the same order again may be carried out.
    """

    request: Name
    done: Yes
    error: Line = ""
    text: Line = ""
    load: Count = 0
    name: Told = ""
    event: Count = 0
    place_x_m: BeltPlace | None = None
    later: Yes = False


@dataclass(frozen=True, slots=True)
class LoadNow:
    """The open load of a line, as the totals tell it: its own sums since its start (`conveyor.messages.Totals`).

    `heights`: how high its tubers are for their width, against earlier loads of its kind; empty where there are none.
    """

    number: Count
    name: Told
    trailer: Told
    field: Told
    variety: Told
    customer: Told
    operator: Told
    since_unix_s: Annotated[float, Range(0, 1e11, "s")]
    count: Count
    weight_g: LoadGrams
    low_g: LoadGrams
    high_g: LoadGrams
    coverage: Annotated[float, Range(0, 1 + 1e-9, "share of the belt")] | None
    estimated_weight_g: LoadGrams
    estimated_low_g: LoadGrams
    estimated_high_g: LoadGrams
    as_weighed_g: LoadGrams
    belt_m: BeltPlace
    unseen_m: Annotated[dict[Word, BeltPlace], Items(64)]
    calibrated_by: Line = ""
    classes: Annotated[tuple[ClassTotal, ...], Items(32)] = ()
    foreign: ForeignTotal | None = None
    heights: Annotated[tuple[HeightChange, ...], Items(256)] = ()
