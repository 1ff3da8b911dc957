"""One travel for all cameras of a line whose belt has no encoder.

Each camera then estimates travel by itself, from its own zero and with its own drift; only the belt is shared. The
first camera's travel is taken as the line's, counted from the moment at which the earliest camera began: a track of
another camera gets its place from the moment it crossed, not from that camera's estimate. With an encoder every camera
reads the same travel and nothing is done.

While the first camera sees no load move (bare belt, frames missed) it carries its travel on by the last speed, and
knows nothing of a belt that stops or starts. Over such a stretch the travel of the camera that saw most load move is
taken: by how much the first one's is ahead of that from then on is its turn (`LineTravel`).

Times here are those of the line's clock, the first camera's; each curve knows how far its own camera's is ahead of it.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

SAMPLES = 100_000
"""Of one camera, 2.4 MB: 1.7 hours of a live camera's marks, a day of a recording's. Beyond it every other one of the
older half goes, again and again: after four times as many the first one alone is left of what came before."""

TURNS = 512
"""Kept, the newest: 15 s of two live cameras' marks on end, minutes of a recording's. No track waits longer."""

UNKNOWN = -1
"""Carried on for how long: not kept any more."""


@dataclass(slots=True)
class TravelCurve:
    """Samples (time, travel) of one camera, from its marks, in its own time; `closed` when no further ones are waited
    for. `ahead_ns`: what its clock is ahead of the line's. `carried_ms`: for how long until then it saw no load move,
    `UNKNOWN` where that is no longer known.
    """

    times_ns: array[int] = field(default_factory=lambda: array("q"))
    travels_m: array[float] = field(default_factory=lambda: array("d"))
    carried_ms: array[int] = field(default_factory=lambda: array("q"))
    closed: bool = False
    ahead_ns: int = 0

    @property
    def first_ns(self) -> int:
        """Time of the first sample; there must be one."""
        return self.times_ns[0] - self.ahead_ns

    @property
    def last_ns(self) -> int:
        """Time of the newest sample; there must be one."""
        return self.times_ns[-1] - self.ahead_ns

    def add(self, captured_ns: int, travel_m: float, carried_ms: int = 0) -> None:
        """Append a sample, in the camera's own time; marks come in order, an equal or older time changes nothing."""
        if not self.times_ns or captured_ns > self.times_ns[-1]:
            self.times_ns.append(captured_ns)
            self.travels_m.append(travel_m)
            self.carried_ms.append(carried_ms)
            if len(self.times_ns) > SAMPLES:
                for kept in (self.times_ns, self.travels_m, self.carried_ms):
                    del kept[1 : SAMPLES // 2 : 2]

    def at(self, t_ns: int) -> float:
        """Travel at `t_ns`, metres, linear between samples and beyond them; there must be one."""
        if len(self.times_ns) == 1:
            return self.travels_m[0]
        left, share = self._left_of(t_ns)
        return self.travels_m[left] + (self.travels_m[left + 1] - self.travels_m[left]) * share

    def reaches(self, t_ns: int) -> bool:
        """`t_ns` lies within the samples, or nothing more will come."""
        return bool(self.times_ns) and (self.closed or t_ns <= self.last_ns)

    def unseen(self, from_ns: int, to_ns: int) -> float | None:
        """Share of that time in which it saw no load move; 1 too where travel of before is told. None where the samples
        do not span it, or do not tell.
        """
        if len(self.times_ns) < 2 or not self.first_ns <= from_ns < to_ns <= self.last_ns:
            return None
        carried_ms = []
        for t_ns in (from_ns, to_ns):
            left, share = self._left_of(t_ns)
            before, after = self.carried_ms[left : left + 2]
            if UNKNOWN in (before, after):
                return None
            carried_ms.append(before + (after - before) * share)
        return min(1.0, (carried_ms[1] - carried_ms[0]) * 1e6 / (to_ns - from_ns))

    def _left_of(self, t_ns: int) -> tuple[int, float]:
        """The sample before `t_ns`, and where between it and the next one `t_ns` lies; there must be two."""
        own_ns = t_ns + self.ahead_ns
        right = min(max(bisect_right(self.times_ns, own_ns), 1), len(self.times_ns) - 1)
        t0, t1 = self.times_ns[right - 1], self.times_ns[right]
        return right - 1, (own_ns - t0) / (t1 - t0)


def best_seeing(curves: Mapping[str, TravelCurve], from_ns: int, to_ns: int) -> TravelCurve | None:
    """Which camera saw load move for most of that time, the first of equal ones; None where no samples span it."""
    best, least = None, float("inf")
    for curve in curves.values():
        unseen = curve.unseen(from_ns, to_ns)
        if unseen is not None and unseen < least:
            best, least = curve, unseen
    return best


def _samples_between(curves: Sequence[TravelCurve], from_ns: int, to_ns: int) -> list[int]:
    """The two times and those of the samples between them, ascending."""
    found = {from_ns, to_ns}
    for curve in curves:
        begin, end = (bisect_right(curve.times_ns, t_ns + curve.ahead_ns) for t_ns in (from_ns, to_ns))
        found.update(t_ns - curve.ahead_ns for t_ns in curve.times_ns[begin:end])
    return sorted(found)


LONGEST_HEAD_START_NS = 60_000_000_000
"""A camera that began longer before the reference runs on another clock."""


def head_start_m(curves: Mapping[str, TravelCurve], *, reference: str) -> float | None:
    """How far the belt moved from the earliest camera's first sample to the reference's, metres; None if unknown."""
    line = curves[reference]
    if not line.times_ns:
        return 0.0 if line.closed else None
    first_ns = line.first_ns
    earliest = line
    for curve in curves.values():
        if not curve.times_ns:
            if not curve.closed:
                return None
        elif curve.first_ns < earliest.first_ns and first_ns - curve.first_ns <= LONGEST_HEAD_START_NS:
            earliest = curve
    if not earliest.reaches(first_ns):
        return None
    return earliest.at(first_ns) - earliest.travels_m[0] if first_ns <= earliest.last_ns else 0.0


def common_travel_m(
    curves: Mapping[str, TravelCurve], *, reference: str, camera: str, t_ns: int, own_travel_m: float
) -> float | None:
    """The reference's travel at `t_ns` of the camera's own time, metres, or None while it has not come that far.

    Outside the reference's samples (it started later or ended earlier) the camera's own travel goes on from there.
    """
    if camera == reference:
        return own_travel_m
    line, own = curves[reference], curves[camera]
    if not line.times_ns:
        return own_travel_m if line.closed else None
    first_ns, last_ns, t_ns = line.first_ns, line.last_ns, t_ns - own.ahead_ns
    if first_ns <= t_ns <= last_ns:
        return line.at(t_ns)
    if t_ns > last_ns and not line.closed:
        return None
    anchor_ns = first_ns if t_ns < first_ns else last_ns
    if not own.times_ns or not own.reaches(anchor_ns):
        return None if not own.closed else line.at(t_ns)
    return line.at(anchor_ns) + own_travel_m - own.at(anchor_ns)


@dataclass(frozen=True, slots=True)
class TravelKnown:
    """What the ledger keeps of a line's travel that is estimated.

    Attributes:
        head_start_m: belt before the first camera's first sample; None while that is not known.
        turns: (time, metres by which the first camera's travel is ahead of the line's), ascending; between two of them
            it grows evenly.
    """

    head_start_m: float | None = None
    turns: tuple[tuple[int, float], ...] = ()


NOT_KNOWN = TravelKnown()


@dataclass(slots=True)
class LineTravel:
    """The line's travel at the moments of its cameras; `curves` are theirs, the first camera's first.

    Attributes:
        turns: as in `TravelKnown`. through_ns: up to which time they are known; None: nothing is yet.
    """

    curves: Mapping[str, TravelCurve]
    head_start_m: float | None = None
    turns: list[tuple[int, float]] = field(default_factory=list)
    through_ns: int | None = None

    @property
    def _first(self) -> TravelCurve:
        return next(iter(self.curves.values()))

    @property
    def known(self) -> TravelKnown:
        """For the ledger."""
        return TravelKnown(self.head_start_m, tuple(self.turns))

    def restored(self, known: TravelKnown) -> None:
        """As the ledger has it. What followed the newest turn gave none, or is found again in the samples."""
        self.head_start_m, self.turns = known.head_start_m, list(known.turns)
        self.through_ns = self.turns[-1][0] if self.turns else None

    def travel_m(
        self, camera: str, *, t_ns: int, own_travel_m: float, told: str | None = None, wait: bool = True
    ) -> float | None:
        """Of the line at `t_ns` of the camera's own time, metres; None while that is not known, without `wait` as far
        as it is known now. `told`: the first camera to which an encoder tells it.
        """
        reference = told or next(iter(self.curves))
        ahead_m = 0.0 if told else self._ahead_m(t_ns - self.curves[camera].ahead_ns, wait=wait)
        if self.head_start_m is None:
            self.head_start_m = 0.0 if told else head_start_m(self.curves, reference=reference)
        if self.head_start_m is None or ahead_m is None:
            return None
        travel_m = common_travel_m(
            self.curves, reference=reference, camera=camera, t_ns=t_ns, own_travel_m=own_travel_m
        )
        return None if travel_m is None else travel_m - ahead_m + self.head_start_m

    def follow(self) -> None:
        """Take what is new in the samples, as far as all cameras have come that are waited for."""
        first, *others = self.curves.values()
        at = 0 if self.through_ns is None else bisect_right(first.times_ns, self.through_ns)
        for to in range(at, len(first.times_ns) if others else 0):
            to_ns = first.times_ns[to]
            if to > 0 and first.carried_ms[to] > first.carried_ms[to - 1] != UNKNOWN:
                if any(self._awaited(curve, to_ns) for curve in others):
                    return
                for begin_ns, end_ns in pairwise(_samples_between(others, first.times_ns[to - 1], to_ns)):
                    self._turn(begin_ns, end_ns)
            self.through_ns = to_ns

    def _awaited(self, curve: TravelCurve, t_ns: int) -> bool:
        """More may be told of `t_ns`; one that began long before or after the first runs on another clock."""
        if curve.closed or not curve.times_ns:
            return not curve.closed
        began_apart_ns = abs(curve.first_ns - self._first.first_ns)
        return t_ns > curve.last_ns and began_apart_ns <= LONGEST_HEAD_START_NS

    def _turn(self, from_ns: int, to_ns: int) -> None:
        first, (newest_ns, ahead_m) = self._first, self.turns[-1] if self.turns else (None, 0.0)
        best = best_seeing(self.curves, from_ns, to_ns)
        if best is None or best is first or (newest_ns is not None and to_ns <= newest_ns):
            return
        if newest_ns is None or newest_ns < from_ns:
            self.turns.append((from_ns, ahead_m))
        more_m = first.at(to_ns) - first.at(from_ns) - best.at(to_ns) + best.at(from_ns)
        self.turns.append((to_ns, ahead_m + more_m))
        del self.turns[:-TURNS]

    def _ahead_m(self, t_ns: int, *, wait: bool) -> float | None:
        """At `t_ns`, metres, and what it was last beyond that; None where it is to be known and is not yet."""
        if wait and len(self.curves) > 1 and (self.through_ns is None or t_ns > self.through_ns):
            followed = not self._first.times_ns or self.through_ns == self._first.last_ns
            if not (self._first.closed and followed):
                return None
        if not self.turns:
            return 0.0
        right = bisect_right(self.turns, t_ns, key=lambda turn: turn[0])
        if right in (0, len(self.turns)):
            return self.turns[max(0, right - 1)][1]
        (t0, a0), (t1, a1) = self.turns[right - 1 : right + 1]
        return a0 + (a1 - a0) * (t_ns - t0) / (t1 - t0)
