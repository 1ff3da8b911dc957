"""What the process of a device on a line does beside reading it: it comes back by itself, and knows what time it is."""

from __future__ import annotations

import time

from camera_sim.day_clock import DayClock
from conveyor.errors import DeviceError
from conveyor.node import Node

BACK_OFF_S = (0.5, 1.0, 2.0, 5.0, 10.0)


class DeviceCare:
    """A device that goes is opened again, with back-off, forever; steps of this machine's clock are left out, and told.

    Args:
        lost: the counter of how often it went. told: what goes on through a step of the clock, in a word.
    """

    def __init__(self, node: Node, *, lost: str, told: str) -> None:
        self._node, self._counter, self._told = node, lost, told
        self._clock = DayClock()
        self._tried = 0

    def opened(self) -> None:
        """It is there."""
        self._tried = 0

    def lost(self, error: DeviceError) -> None:
        """It is gone, or not there: rest before the next try."""
        pause_s = BACK_OFF_S[min(self._tried, len(BACK_OFF_S) - 1)]
        self._node.counters.add(self._counter)
        self._node.log.warning("%s; tried again in %g s", error, pause_s)
        self.rest(pause_s)
        self._tried += 1

    def rest(self, seconds: float) -> bool:
        """Sleep; True when the node is to stop."""
        until_s = time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > 0:
            if self._node.stop.wait(min(left_s, 0.5)):
                return True
            self._node.progress()
        return self._node.stop.is_set()

    def day_ns(self) -> int:
        """The time of the day as the run's cameras have it: without the steps of this clock since the start."""
        day_ns, step_ns = self._clock.now()
        if step_ns:
            self._node.counters.add("clock_steps")
            self._node.log.warning(
                "this machine's clock was set by %+.3f s: %s go on as if it had not, as the cameras do",
                step_ns / 1e9, self._told,
            )  # fmt: skip
        return day_ns
