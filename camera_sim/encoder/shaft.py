"""From counts to metres: a counter that is full and begins again, and one that lost its count. Reads no clock."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from enum import Enum, auto

FASTEST_MPS, BACK_MPS = 5.0, 1.0
"""No belt of a harvester is half as fast, on or back."""
JITTER_M = 0.02
"""Counts come in bursts: so much belt may be told at once."""
SECOND_NS = 1_000_000_000
KEPT = 2000
"""Newest readings, of 20 s and more."""


class Reading(Enum):
    """What a count is taken for."""

    GOOD = auto()
    ODD = auto()
    """No belt moves so: noise on its cable, or the counter lost its count; the next one tells."""
    LOST = auto()
    """The counter lost its count: how far the belt moved meanwhile is not known, and it turns on from here."""


class Shaft:
    """How far the shaft has turned since it was first read, metres of belt.

    Args:
        metres_per_pulse: below 0 where it counts down while the belt runs on.
        bits: of the counter.

    Attributes:
        jump: by which the count was lost last, in words.
    """

    def __init__(self, metres_per_pulse: float, *, bits: int) -> None:
        self._metres_per_pulse = metres_per_pulse
        self._full = 1 << bits
        self._pulses = 0
        self._last: tuple[int, int] | None = None
        self._odd: tuple[int, int] | None = None
        self._reopened = False
        self._turns: deque[tuple[int, float]] = deque(maxlen=KEPT)
        self.jump = ""

    def read(self, count: int, at_ns: int) -> Reading:
        """Take a count that was read at `at_ns` (monotonic)."""
        if self._last is None:
            self._go_on(count, at_ns)
            return Reading.GOOD
        moved_m = self._moved_m(self._last, count, at_ns)
        if moved_m is not None:  # what came between was noise
            self._pulses += self._pulses_from(self._last[0], count)
            self._go_on(count, at_ns)
            return Reading.GOOD
        odd, self._odd = self._odd, (count, at_ns)
        if odd is None or self._moved_m(odd, count, at_ns) is None:
            return Reading.ODD
        since_s = (at_ns - self._last[1]) * 1e-9
        self.jump = f"from {self._last[0]} to {count} in {since_s:.3f} s"
        self._turns.clear()
        self._go_on(count, at_ns)
        return Reading.LOST

    def _go_on(self, count: int, at_ns: int) -> None:
        self._last, self._odd, self._reopened = (count, at_ns), None, False
        self._turns.append((at_ns, self.turned_m))

    def _pulses_from(self, before: int, count: int) -> int:
        return (count - before + self._full // 2) % self._full - self._full // 2

    def _moved_m(self, before: tuple[int, int], count: int, at_ns: int) -> float | None:
        """From one reading to another, metres; None where no belt moves so."""
        moved_m = self._pulses_from(before[0], count) * self._metres_per_pulse
        since_s = (at_ns - before[1]) * 1e-9
        back_m = 0.0 if self._reopened else BACK_MPS * since_s
        return moved_m if -JITTER_M - back_m <= moved_m <= JITTER_M + FASTEST_MPS * since_s else None

    def reopened(self) -> None:
        """The device was away: should it be back with less than it had, it was without power."""
        self._reopened = True

    @property
    def turned_m(self) -> float:
        """Since it was first read."""
        return self._pulses * self._metres_per_pulse

    def speed_mps(self) -> float:
        """Over the newest second; 0 where less is known."""
        if len(self._turns) < 2:
            return 0.0
        t1, x1 = self._turns[-1]
        t0, x0 = next((turn for turn in reversed(self._turns) if t1 - turn[0] >= SECOND_NS), self._turns[0])
        return (x1 - x0) / max(t1 - t0, 1) * 1e9

    def turned_at(self, at_ns: int) -> float | None:
        """The same at a moment among the newest readings, linear between them; None where they do not reach back."""
        if not self._turns or at_ns < self._turns[0][0]:
            return None
        right = bisect_left(self._turns, at_ns, key=lambda turn: turn[0])
        if right == len(self._turns):
            return self.turned_m
        (t1, x1), (t0, x0) = self._turns[right], self._turns[max(right - 1, 0)]
        return x1 if t1 == t0 else x0 + (x1 - x0) * (at_ns - t0) / (t1 - t0)
