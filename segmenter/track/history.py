"""When the belt was where: capture times against travel, for crossings between frames."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field

from segmenter.track.constants import KEPT_FRAMES, STILL_M


@dataclass(slots=True)
class TravelHistory:
    """The travels of the processed frames. A standing belt adds nothing but its last moment; memory is bounded.

    `anchor` is where counting starts: the first frame, or where an earlier process of this run left off.
    """

    anchor: tuple[int, float] | None = None
    _times: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=KEPT_FRAMES))
    _moved: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT_FRAMES))

    def step(self, captured_ns: int, travel_m: float) -> bool:
        """Add a frame; True where the belt moved since the last frame that counts of its own."""
        if self.anchor is None:
            self.anchor = (captured_ns, travel_m)
        if not self._times:
            self._times.append(self.anchor)
        if len(self._times) >= 3 and max(abs(t - travel_m) for _, t in list(self._times)[-2:]) < STILL_M:
            self._times.pop()
        self._times.append((captured_ns, travel_m))
        moved = not self._moved or abs(travel_m - self._moved[-1]) >= STILL_M
        if moved:
            self._moved.append(travel_m)
        return moved

    def shift(self, by_m: float) -> None:
        """The belt had moved `by_m` more than was known since the anchor."""
        if self.anchor is not None:
            later = [(t, x + by_m) for t, x in self._times if t > self.anchor[0] and x != self.anchor[1]]
            self._times = deque([self.anchor, *later], maxlen=KEPT_FRAMES)
            self._moved = deque([x + by_m for x in self._moved], maxlen=KEPT_FRAMES)

    @property
    def start_m(self) -> float:
        """Travel at which counting starts."""
        return self.anchor[1] if self.anchor else 0.0

    def frames_between(self, low_m: float, high_m: float) -> int:
        """Frames, standing ones once, whose travel lies within."""
        return sum(low_m <= travel_m <= high_m for travel_m in self._moved)

    def ns_at(self, travel_m: float) -> int:
        """Time at which the belt first reached a travel, interpolated; the nearest end where it never did."""
        times = list(self._times)
        reached = [times[0][1]]
        for _, value in times[1:]:
            reached.append(max(reached[-1], value))
        index = bisect_left(reached, travel_m)
        if index == 0:
            return times[0][0]
        if index == len(times):
            return times[-1][0]
        (t0, x0), (t1, x1) = times[index - 1], times[index]
        share = (travel_m - x0) / (x1 - x0) if x1 > x0 else 1.0
        return t0 + round(max(0.0, min(1.0, share)) * (t1 - t0))
