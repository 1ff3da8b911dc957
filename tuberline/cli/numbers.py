"""What a word on the command line may be: not empty; a number finite, whole where whole ones are asked for, and within
its range.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

from cyclopts import UNSET, CoercionError, Parameter, Token, convert

from conveyor.stated import (
    BELT_DISTANCE_M,
    RESTING_OFFSET_MM,
    RESTING_SD_MM,
    SCALE_ERROR_KG,
    TICKET_KG,
    level_fault,
)

EXAMPLES = {float: "8.61", int: "12"}


def as_written(kind: Any, tokens: Sequence[Token] | dict[str, Any]) -> Any:
    """The words of an option as its type. Cyclopts alone reads 1.5 as 2 where a whole number is asked for, and an empty
    word, which a variable that is not set leaves, as the folder that one is in, or as the load that was last.

    Raises:
        CoercionError: an empty word; a number that is none, with the word and how it is written.
    """
    asked = next((number for number in (float, int) if number in (kind, *get_args(kind))), None)
    for token in tokens if not isinstance(tokens, dict) else ():
        if token.implicit_value is not UNSET:  # a flag, which has no word of its own
            continue
        if asked is not None and not _is_number(token.value, asked):
            raise CoercionError(msg=_no_number(token.value, asked), token=token, target_type=asked)
        if not token.value:
            raise CoercionError(msg=_empty(kind), token=token, target_type=str)
    return convert(kind, tokens)


def _empty(kind: Any) -> str:
    """That a word is missing, and where such words come from."""
    what = "path" if Path in (kind, *get_args(kind)) else "word"
    return f'"" is empty, and a {what} is needed there; a variable of the shell that is not set gives such a word.'


def _no_number(given: str, kind: type) -> str:
    """Why `given` is no float or int, and how it is written."""
    with_point = given.strip().replace(",", ".")
    example = with_point if _is_number(with_point, kind) else EXAMPLES[kind]
    told = "number" if kind is float else "whole number"
    return f'"{given}" is no {told}; write it like {example}.'


def _is_number(text: str, kind: type) -> bool:
    if kind is int:
        return re.fullmatch(r"[+-]?\d+(\.0*)?", text.strip()) is not None
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


@dataclass(frozen=True, slots=True)
class Within:
    """Refuses a number outside of `low` to `high`, both allowed."""

    low: float
    high: float
    unit: str

    def __call__(self, _kind: Any, value: float | None) -> None:
        """Raises ValueError, which cyclopts tells with the option and the value."""
        if value is not None and not self.low <= value <= self.high:
            unit = f" {self.unit}" if self.unit else ""
            raise ValueError(f"Allowed is {self.low:.15g} to {self.high:.15g}{unit}.")


@dataclass(frozen=True, slots=True)
class Level(Within):
    """The same of a height in millimetres that was measured: metres are no such number."""

    def __call__(self, kind: Any, value: float | None) -> None:
        """Raises ValueError, which cyclopts tells with the option and the value."""
        Within.__call__(self, kind, value)
        if value is not None and (fault := level_fault(value)):
            raise ValueError(f"{fault.capitalize()}.")


def within(low: float, high: float, unit: str = "") -> Parameter:
    """For the annotation of an option: `frames: Annotated[int, within(1, 1000)]`."""
    return Parameter(validator=Within(low, high, unit))


Many = Annotated[int, within(1, 10**9)]
"""How many of something there must be some of."""
Seed = Annotated[int, within(0, 10**18)]
"""The same seed gives the same."""
TrackShift = Annotated[float, within(-1e9, 1e9, "s")]
TicketKg = Annotated[float, within(*TICKET_KG, "kg")]
"""What a scale said."""
ScaleErrorKg = Annotated[float, within(*SCALE_ERROR_KG, "kg")]
BeltDistance = Annotated[float, within(*BELT_DISTANCE_M, "m")]
RestingOffset = Annotated[float, Parameter(validator=Level(*RESTING_OFFSET_MM, "mm, positive below the belt"))]
RestingSd = Annotated[float, Parameter(validator=Level(*RESTING_SD_MM, "mm"))]
