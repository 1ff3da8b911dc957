"""One travel for all cameras of a line whose belt has no encoder.

Each camera then estimates travel by itself, from its own zero and with its own drift; only the belt is shared. The
first camera's travel is taken as the line's, counted from the moment at which the earliest camera began: a track of
another camera gets its place from the moment it crossed, not from that camera's estimate. With an encoder every camera
reads the same travel and nothing is done.

Times here are those of the line's clock, the first camera's; each curve knows how far its own camera's is ahead of it.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, field

SAMPLES = 100_000
"""Of one camera, 1.6 MB: 1.7 hours of a live camera's marks, a day of a recording's. Beyond it every other one of the
older half goes, again and again: after four times as many the first one alone is left of what came before."""


@dataclass(slots=True)
class TravelCurve:
    """Samples (time, travel) of one camera, from its marks, in its own time; `closed` when no further ones are waited
    for. `ahead_ns`: what its clock is ahead of the line's.
    """

    times_ns: array[int] = field(default_factory=lambda: array("q"))
    travels_m: array[float] = field(default_factory=lambda: array("d"))
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

    def add(self, captured_ns: int, travel_m: float) -> None:
        """Append a sample, in the camera's own time; marks come in order, an equal or older time changes nothing."""
        if not self.times_ns or captured_ns > self.times_ns[-1]:
            self.times_ns.append(captured_ns)
            self.travels_m.append(travel_m)
            if len(self.times_ns) > SAMPLES:
                del self.times_ns[1 : SAMPLES // 2 : 2]
                del self.travels_m[1 : SAMPLES // 2 : 2]

    def at(self, t_ns: int) -> float:
        """Travel at `t_ns`, metres, linear between samples and beyond them; there must be one."""
        if len(self.times_ns) == 1:
            return self.travels_m[0]
        t_ns += self.ahead_ns
        right = min(max(bisect_right(self.times_ns, t_ns), 1), len(self.times_ns) - 1)
        t0, t1 = self.times_ns[right - 1], self.times_ns[right]
        x0, x1 = self.travels_m[right - 1], self.travels_m[right]
        return x0 + (x1 - x0) * ((t_ns - t0) / (t1 - t0))

    def reaches(self, t_ns: int) -> bool:
        """`t_ns` lies within the samples, or nothing more will come."""
        return bool(self.times_ns) and (self.closed or t_ns <= self.last_ns)


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
    """The line's travel at `t_ns` of the camera's own time, metres, or None while the reference has not come that far.

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
