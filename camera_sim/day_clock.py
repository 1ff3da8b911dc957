"""The time of the day for positions, without the steps by which a clock is set: as the cameras' times are.

A host that sets its clock a minute after the line began (no battery, a time server that answers late) would else have
tubers by one clock and positions by another, and the map would lay each where the machine never was with it.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from conveyor.camera_clock import STEP_NS

AT_ONCE_NS = 10_000_000


class DayClock:
    """Nanoseconds since 1970 that only go as fast as time passes, as long as this process lives.

    Args:
        wall_ns: the clock that may be set. steady_ns: one that no one sets.

    Attributes:
        offset_ns: what is added to the wall clock by now.
    """

    def __init__(
        self, *, wall_ns: Callable[[], int] = time.time_ns, steady_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._wall_ns, self._steady_ns = wall_ns, steady_ns
        wall, steady = self._both()
        self._apart_ns = wall - steady
        self.offset_ns = 0

    def now(self) -> tuple[int, int]:
        """(the time to go on with, the size of the clock's step since the last call in nanoseconds or 0)."""
        wall_ns, steady_ns = self._both()
        step_ns = wall_ns - steady_ns - self._apart_ns
        self._apart_ns = wall_ns - steady_ns
        if abs(step_ns) <= STEP_NS:
            step_ns = 0
        self.offset_ns -= step_ns
        return wall_ns + self.offset_ns, step_ns

    def _both(self) -> tuple[int, int]:
        """Both clocks, read at once, or again: a process may be paused between."""
        while True:
            before_ns, wall_ns, after_ns = self._steady_ns(), self._wall_ns(), self._steady_ns()
            if after_ns - before_ns < AT_ONCE_NS:
                return wall_ns, after_ns
