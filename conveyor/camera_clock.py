"""A live camera's capture times, checked for sense: a step of its clock is told, and time goes on without it.

Everything that is counted by time (ages, speeds, marks) would otherwise stop until the clock has caught up, an hour
where it was set back by an hour. Nothing here reads a clock.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from statistics import median

AT_START_GAUGE = "camera_clock_at_start_s"
"""Gauge of a live camera's segmenter: what the camera's clock said when the segmenter's `uptime_s` was 0. By it clocks
of cameras on several hosts are compared; no step of a host's clock shows in it."""
STEP_NS = 300_000_000
"""A capture time further than this from where both the frame's number and its arrival put it is a step. Ages of 500 ms
end a frame; device clocks jitter by a few ms, those of ROS nodes by tens."""
STANDS_AFTER_S = 600.0
"""Belt that ran on unseen is guessed by the clock for this long at most: a line that is down for longer was stopped."""
PERIODS = 30
"""Newest frame periods whose median is the camera's."""
UNKNOWN_PERIOD_NS = 33_000_000
UNKNOWN_PERIODS_NS = (8_000_000, 250_000_000)
"""Of cameras with 120 to 4 frames a second."""


@dataclass(slots=True)
class CameraClock:
    """Capture times of one run that only go forward and only as fast as frames come.

    Attributes:
        speed: how many times faster than its clock says a recording is sent; 0: at once, arrivals say nothing.
        floor_ns: the newest time that an earlier process of this run gave; what comes now is later.
        offset_ns: what is added to the camera's own times by now.
    """

    speed: float = 1.0
    floor_ns: int = 0
    offset_ns: int = 0
    _last: tuple[int, int, int] | None = None
    _periods_ns: deque[float] = field(default_factory=lambda: deque(maxlen=PERIODS))

    def steady_ns(self, seq: int, captured_ns: int, arrived_ns: int) -> tuple[int, int]:
        """(the time to go on with, the size of the clock's step in nanoseconds or 0).

        Args:
            seq: the frame's number; lost frames leave a gap.
            captured_ns: the camera's own time.
            arrived_ns: the monotonic time at which the frame was taken up.
        """
        step_ns = self._step_ns(seq, captured_ns, arrived_ns)
        self.offset_ns -= step_ns
        self._last = (seq, captured_ns, arrived_ns)
        return captured_ns + self.offset_ns, step_ns

    def _step_ns(self, seq: int, captured_ns: int, arrived_ns: int) -> int:
        if self._last is None:
            return min(0, captured_ns - self.floor_ns - UNKNOWN_PERIOD_NS) if self.floor_ns else 0
        frames = seq - self._last[0]
        if frames <= 0:  # sent again: it has the time it had
            return 0
        passed_ns = captured_ns - self._last[1]
        # Before the period is known any of a camera's is right: a gap of 150 frames at half the usual rate was a step.
        low_ns, high_ns = (median(self._periods_ns),) * 2 if self._periods_ns else UNKNOWN_PERIODS_NS
        by_number_ns = min(max(passed_ns, frames * low_ns), frames * high_ns)
        by_arrival_ns = (arrived_ns - self._last[2]) * self.speed
        off_ns = min((passed_ns - by_number_ns, passed_ns - by_arrival_ns), key=abs)
        if self.speed <= 0:
            off_ns = passed_ns - by_number_ns if passed_ns <= 0 else 0
        if passed_ns > 0 and abs(off_ns) <= STEP_NS:
            self._periods_ns.append(passed_ns / frames)
            return 0
        # A camera that stood still while its clock stepped: what passed is what passed here.
        return round(passed_ns - max(by_number_ns, by_arrival_ns))
