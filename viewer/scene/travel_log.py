"""Where the belt was when: the link between a tuber's place and the picture it was seen in."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque

from viewer.scene.primitives import Moment

HISTORY = 4096


class TravelLog:
    """The last readings of one source of travel. The first source heard is kept; an encoder replaces an estimate.

    Two sources may count from different origins, so they are never mixed.
    """

    def __init__(self) -> None:
        self._source: str | None = None
        self._estimated = True
        self._moments: deque[Moment] = deque(maxlen=HISTORY)
        self._travels: deque[float] = deque(maxlen=HISTORY)

    def add(self, moment: Moment, travel_m: float, *, source: str, estimated: bool) -> bool:
        """Take a reading; False when it is of another source or not newer than the last one."""
        if source != self._source:
            if self._source is not None and (estimated or not self._estimated):
                return False
            self._source, self._estimated = source, estimated
            self._moments.clear()
            self._travels.clear()
        if self._moments and moment.captured_ns <= self._moments[-1].captured_ns:
            return False
        self._moments.append(moment)
        self._travels.append(travel_m)
        return True

    def at(self, captured_ns: int) -> float | None:
        """Travel at a capture time, metres, interpolated; None where it was not recorded."""
        i = bisect_left(self._moments, captured_ns, key=lambda m: m.captured_ns)
        if i == len(self._moments):
            return None
        here = self._moments[i].captured_ns
        if here == captured_ns:
            return self._travels[i]
        if i == 0:
            return None
        before = self._moments[i - 1].captured_ns
        share = (captured_ns - before) / (here - before)
        return self._travels[i - 1] + share * (self._travels[i] - self._travels[i - 1])

    def when(self, travel_m: float) -> Moment | None:
        """The first reading at which the belt had come at least this far; None outside of what was recorded."""
        i = bisect_left(self._travels, travel_m)
        return self._moments[i] if i < len(self._moments) else None

    def nearest(self, captured_ns: int) -> Moment:
        """`captured_ns` with the sequence number of the last reading before it."""
        i = bisect_right(self._moments, captured_ns, key=lambda m: m.captured_ns)
        return Moment(captured_ns, self._moments[i - 1].seq if i else None)
