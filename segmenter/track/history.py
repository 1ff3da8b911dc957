"""When the belt was where: capture times against travel, for crossings between frames."""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections import deque
from dataclasses import dataclass, field
from itertools import accumulate

from segmenter.track.constants import KEPT_FRAMES, STILL_M


@dataclass(slots=True)
class TravelHistory:
    """The travels of the processed frames. A belt that stands, or shakes where it has been, adds nothing but its last
    moment; memory is bounded, and so is what a question costs, however long the line runs.

    `anchor` is where counting starts: the first frame, or where an earlier process of this run left off.
    """

    anchor: tuple[int, float] | None = None
    _times: list[tuple[int, float]] = field(default_factory=list)
    _reached: list[float] = field(default_factory=list)
    """How far the belt had been at each of `_times`."""
    _moved: deque[float] = field(default_factory=deque)
    _sorted: list[float] = field(default_factory=list)
    """`_moved` by travel."""

    def step(self, captured_ns: int, travel_m: float) -> bool:
        """Add a frame; True where the belt moved since the last frame that counts of its own."""
        if self.anchor is None:
            self.anchor = (captured_ns, travel_m)
        if not self._times:
            self._note(*self.anchor)
        if self._newest_is_idle(travel_m):
            self._times.pop()
            self._reached.pop()
        self._note(captured_ns, travel_m)
        moved = not self._moved or abs(travel_m - self._moved[-1]) >= STILL_M
        if moved:
            self._moved.append(travel_m)
            insort(self._sorted, travel_m)
            if len(self._moved) > KEPT_FRAMES:
                del self._sorted[bisect_left(self._sorted, self._moved.popleft())]
        return moved

    def shift(self, by_m: float) -> None:
        """The belt had moved `by_m` more than was known since the anchor."""
        if self.anchor is not None:
            later = [(t, x + by_m) for t, x in self._times if t > self.anchor[0] and x != self.anchor[1]]
            self._times = [self.anchor, *later]
            self._reached = list(accumulate((x for _, x in self._times), max))
            self._moved = deque(x + by_m for x in self._moved)
            self._sorted = sorted(self._moved)

    @property
    def start_m(self) -> float:
        """Travel at which counting starts."""
        return self.anchor[1] if self.anchor else 0.0

    def frames_between(self, low_m: float, high_m: float) -> int:
        """Frames, standing ones once, whose travel lies within."""
        return max(0, bisect_right(self._sorted, high_m) - bisect_left(self._sorted, low_m))

    def ns_at(self, travel_m: float) -> int:
        """Time at which the belt first reached a travel, interpolated; the nearest end where it never did."""
        times, reached = self._times, self._reached
        index = bisect_left(reached, travel_m)
        if index == 0:
            return times[0][0]
        if index == len(times):
            return times[-1][0]
        (t0, x0), (t1, x1) = times[index - 1], times[index]
        share = (travel_m - x0) / (x1 - x0) if x1 > x0 else 1.0
        return t0 + round(max(0.0, min(1.0, share)) * (t1 - t0))

    def _newest_is_idle(self, travel_m: float) -> bool:
        """The newest entry says nothing of when the belt was where, once there is one at `travel_m` after it."""
        if len(self._times) < 3:
            return False
        stands = max(abs(t - travel_m) for _, t in self._times[-2:]) < STILL_M
        return stands or self._reached[-3] >= max(self._reached[-1], travel_m)

    def _note(self, captured_ns: int, travel_m: float) -> None:
        self._times.append((captured_ns, travel_m))
        self._reached.append(max(self._reached[-1], travel_m) if self._reached else travel_m)
        if len(self._times) > KEPT_FRAMES:
            del self._times[0], self._reached[0]
            if self._reached[0] != self._times[0][1]:  # the belt had run back: from here on it had not been so far
                self._reached = list(accumulate((x for _, x in self._times), max))
