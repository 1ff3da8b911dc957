"""The part of a run that met the scale: by the numbers of its tubers, or by places on the belt."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from conveyor.messages import Tuber

_NAME = re.compile(
    r"(?:tubers (?P<first>\d+) to (?:(?P<last>\d+)|the last))?(?:, )?"
    r"(?:places (?:(?P<from>[-+.e\d]+) m|the end) to (?:(?P<to>[-+.e\d]+) m|the end))?"
)
_ALL = (-math.inf, math.inf)


@dataclass(frozen=True, slots=True)
class Part:
    """Which tubers of a run met the scale: by id, or by place on the belt; all of them by default.

    Places fall as the belt runs: from -1.5 m on is what passed after the tuber at -1.5 m. Two places may stand in any
    order.
    """

    first: int | None = None
    last: int | None = None
    from_x_m: float | None = None
    to_x_m: float | None = None

    @property
    def name(self) -> str:
        """In words; '' for the whole run."""
        ids = f"tubers {self.first or 1} to {self.last or 'the last'}" if self.first or self.last else ""
        if self.from_x_m is None and self.to_x_m is None:
            return ids
        ends = [f"{x:g} m" if x is not None else "the end" for x in (self.from_x_m, self.to_x_m)]
        return ", ".join(filter(None, (ids, f"places {ends[0]} to {ends[1]}")))

    @classmethod
    def named(cls, name: str) -> Part | None:
        """The part that has this name; None where none is called so."""
        found = _NAME.fullmatch(name)
        if found is None:
            return None
        ids = [int(found[end]) if found[end] else None for end in ("first", "last")]
        places_m = [float(found[end]) if found[end] else None for end in ("from", "to")]
        return cls(*ids, *places_m)

    def holds(self, tuber: Tuber) -> bool:
        """The tuber belongs to it."""
        low, high = self._ids()
        low_m, high_m = self._places_m()
        return low <= tuber.tuber_id < high and low_m <= tuber.place_x_m <= high_m

    def overlaps(self, other: Part) -> bool | None:
        """Some tubers belong to both; None where one goes by numbers, the other by places: it cannot be told."""
        if Part() in (self, other):
            return True
        pairs = ((self._ids(), other._ids()), (self._places_m(), other._places_m()))
        told = [(one, two) for one, two in pairs if _ALL not in (one, two)]
        if not told:
            return None
        return all(max(one[0], two[0]) < min(one[1], two[1]) for one, two in told)

    def _ids(self) -> tuple[float, float]:
        """The first tuber and the one after the last."""
        return (
            -math.inf if self.first is None else self.first,
            math.inf if self.last is None else self.last + 1,
        )

    def _places_m(self) -> tuple[float, float]:
        """The lowest place and the highest."""
        if self.from_x_m is not None and self.to_x_m is not None:
            return min(self.from_x_m, self.to_x_m), max(self.from_x_m, self.to_x_m)
        return (
            -math.inf if self.to_x_m is None else self.to_x_m,
            math.inf if self.from_x_m is None else self.from_x_m,
        )
