"""What a field may hold, said where the field is declared: `weight_g: Annotated[float, Range(0, 5000, "g")]`.

One declaration serves three readers: a person, the check of every message on its way in and out
(`conveyor.messages.base`), and the fuzzer, which builds values at and beyond each limit (`tests/fuzz`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, GroupedMetadata, Le, MaxLen
from pydantic.types import Strict, StringConstraints

INT64_MAX = (1 << 63) - 1
FASTEST_MPS = 3.0
"""Metres per second: no belt runs faster, ten times a harvester's."""
MAX_COUNT = 1 << 53
"""Beyond it JSON readers, and a page in a browser, no longer tell whole numbers apart."""


@dataclass(frozen=True, slots=True)
class Range(GroupedMetadata):
    """A number from `low` to `high`, both allowed, finite; a text or a truth value is none."""

    low: float
    high: float
    unit: str

    def __iter__(self) -> Iterator[object]:
        yield from (Strict(), Ge(self.low), Le(self.high))


@dataclass(frozen=True, slots=True)
class Text(GroupedMetadata):
    """At most `most` characters that match `pattern`; any where that is empty. A number is no text."""

    most: int
    pattern: str = ""

    def __iter__(self) -> Iterator[object]:
        yield StringConstraints(strict=True, max_length=self.most, pattern=self.pattern or None)


@dataclass(frozen=True, slots=True)
class Items(GroupedMetadata):
    """A list or a map of at most `most` items."""

    most: int

    def __iter__(self) -> Iterator[object]:
        yield MaxLen(self.most)


Yes = Annotated[bool, Strict()]
"""True or false, and nothing that merely could be read as one."""

Name = Annotated[str, Text(64, r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
"""A camera, run, node or line: what `conveyor.topics.check_name` allows."""

Id = Annotated[str, Text(240, r"^[A-Za-z0-9._/-]{1,240}$")]
"""A track id, `<run>/<camera>/<seq>-<n>`, or a view id, `<track_id>/<seq>`."""

Word = Annotated[str, Text(256, r"^[^\x00-\x1f\x7f]*$")]
"""A reason, a flag, a counter's name, a version: one word of ours, or a few put together."""

Words = Annotated[tuple[Word, ...], Items(256)]

Line = Annotated[str, Text(4096)]
"""What a person reads, or a path on some machine."""

Model = Annotated[str, Text(4096, r"^[^\x00-\x1f\x7f]*$")]
"""Name and hash of weights; a tuber weighed by several has them all, joined by '+'."""

Nanoseconds = Annotated[int, Range(0, INT64_MAX, "ns")]
"""A moment of a camera's clock."""

Seq = Annotated[int, Range(0, MAX_COUNT, "frames")]
"""Number of a frame within its run."""

Count = Annotated[int, Range(0, MAX_COUNT, "")]

Sheet = Annotated[dict[Word, Annotated[int, Range(-MAX_COUNT, MAX_COUNT, "")]], Items(256)]
"""Counts by name. One that is the difference of two others may be below zero where these were told apart in time."""

Counts = Annotated[dict[Word, Count], Items(256)]
"""Counts by reason."""

BeltPlace = Annotated[float, Range(-1e7, 1e7, "m")]
"""Along the belt since the run started: 10,000 km either way, a belt at 0.6 m/s for half a year."""

BeltLength = Annotated[float, Range(0, 1e7, "m")]

InView = Annotated[float, Range(-100, 100, "m")]
"""A belt coordinate of something that a camera sees."""

DepthScale = Annotated[float, Range(1e-6, 0.01, "m per unit")]
"""Metres per unit of depth; RealSense cameras use 0.0001 to 0.001."""

BeltDistance = Annotated[float, Range(1e-3, 100, "m")]
"""Camera to belt along the optical axis."""

Millimetres = Annotated[float, Range(0, 2000, "mm")]
"""An axis of a tuber. The longest of 859 has 170 mm; what is longer than 2 m is no tuber, whatever it is."""

Millilitres = Annotated[float, Range(0, 1e6, "ml")]
"""A volume under a visible surface, up to one cubic metre."""

ViewGrams = Annotated[float, Range(0, 1e5, "g")]
"""A weight by one view. Tubers weigh 16 to 624 g; a view of several taken for one may say some kilograms."""

TuberGrams = Annotated[float, Range(0, 1e9, "g")]
"""A fused weight or a bound of its interval, which views that contradict each other make very wide."""

LoadGrams = Annotated[float, Range(0, 1e300, "g")]
"""A sum over tubers, and that over the share of the belt that was seen, which may be next to nothing."""
