"""A buyer's contract: classes of size by square mesh or by length, and what share of a load each may have.

measure = "mesh"                  # or "length"
name = "table potatoes"

[[classes]]
name = "ware"
from_mm = 35
to_mm = 55
at_least_percent = 90             # of the load's weight; at_most_percent likewise
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from conveyor.errors import ConfigError
from conveyor.refused import in_words
from conveyor.text_files import read_toml

LARGEST_MM = 256.0
MOST_CLASSES = 32


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class SizeClass(_Part):
    """One class: tubers of at least `from_mm` and less than `to_mm`; None: without that bound."""

    name: str = Field(min_length=1, max_length=60, pattern=r"^[^\x00-\x1f\x7f]*$")
    from_mm: float | None = Field(None, ge=0, le=LARGEST_MM)
    to_mm: float | None = Field(None, ge=0, le=LARGEST_MM)
    at_least_percent: float | None = Field(None, ge=0, le=100)
    at_most_percent: float | None = Field(None, ge=0, le=100)

    @property
    def low_mm(self) -> float:
        """Its lower edge; 0 without one."""
        return self.from_mm or 0.0

    @property
    def high_mm(self) -> float:
        """Its upper edge; infinite without one."""
        return math.inf if self.to_mm is None else self.to_mm

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if self.low_mm >= self.high_mm:
            raise ValueError(f"class '{self.name}' goes from {self.low_mm:g} to {self.high_mm:g} mm: give from < to")
        if None not in (least := self.at_least_percent, most := self.at_most_percent) and (least or 0) > (most or 0):
            raise ValueError(f"class '{self.name}' wants at least {least:g} and at most {most:g} %: no share is both")
        return self


class Contract(_Part):
    """All classes of a contract, which do not overlap, by the measure that they are edges of."""

    name: str = Field("", max_length=60, pattern=r"^[^\x00-\x1f\x7f]*$")
    measure: Literal["mesh", "length"] = "mesh"
    classes: tuple[SizeClass, ...] = Field(min_length=1, max_length=MOST_CLASSES)

    @property
    def told(self) -> str:
        """Its name and measure in words."""
        measure = "square mesh" if self.measure == "mesh" else "length"
        return f"{self.name}, by {measure}" if self.name else f"by {measure}"

    @model_validator(mode="after")
    def _apart(self) -> Self:
        names = [each.name for each in self.classes]
        if len(set(names)) < len(names):
            raise ValueError("two classes have the same name; give each its own")
        for a, b in itertools.pairwise(sorted(self.classes, key=lambda each: each.low_mm)):
            if b.low_mm < a.high_mm:
                raise ValueError(
                    f"classes '{a.name}' and '{b.name}' overlap from {b.low_mm:g} to {min(a.high_mm, b.high_mm):g} mm: "
                    "a tuber would be in both"
                )
        return self


def read_contract(path: Path) -> Contract:
    """The contract in the TOML file at `path`.

    Raises:
        ConfigError: unreadable, not TOML, or refused; the text names every faulty key.
    """
    raw = read_toml(path, what="contract", error=ConfigError)
    try:
        return Contract.model_validate(raw)
    except ValidationError as error:
        faults = error.errors()
        # Where its classes are refused pydantic goes on without them, and finds their list too short.
        at_fault = {fault["loc"][:n] for fault in faults for n in range(1, len(fault["loc"]))}
        told = [_fault(fault) for fault in faults if fault["loc"] not in at_fault]
        raise ConfigError(f"contract {path} is refused:\n" + "\n".join(told)) from error


def _fault(fault: Any) -> str:
    where = ".".join(map(str, fault["loc"])) or "contract"
    if fault["type"] == "missing":
        return f"  {where}: {in_words(fault)}"
    if fault["type"] != "extra_forbidden":
        return f"  {where}: {in_words(fault)} (got {fault.get('input')!r})"
    known = (Contract if len(fault["loc"]) == 1 else SizeClass).model_fields
    return f"  {where}: unknown key; known here: {', '.join(known)}"
