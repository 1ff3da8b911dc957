"""How far cameras' clocks differ, from what their segmenters report: hosts may disagree about the time by any amount.

Without an encoder the belts of several cameras are laid side by side by capture times. A segmenter reports once a
second what its camera's clock says; what is the same for all reports is the clocks' difference, and the rest is the way
here, which is never shorter than nothing: the quickest of the last reports tells it to a few milliseconds. Nothing here
reads a clock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

REMEMBERED = 60
"""Reports of each camera, one a second: hosts' clocks drift against each other by 0.05 ms a second, or 0.5 slewed."""
ENOUGH = 3
"""Reports after which the quickest is trusted."""
AGREE_NS = 50_000_000
"""Clocks that differ by less agree, by their own account: a report on a busy host may be that late. 15 mm of belt."""


@dataclass(slots=True)
class CameraClocks:
    """Collects reports, and says by how much each camera's clock is ahead of the first one's."""

    _seen: dict[str, deque[float]] = field(default_factory=dict)
    _newest: dict[str, float] = field(default_factory=dict)

    def reported(self, camera: str, camera_s: float, *, arrived_s: float) -> None:
        """A report came. One that is told again, for nothing newer has come, changes nothing.

        Args:
            camera_s: what the camera's clock said when the report was sent, seconds.
            arrived_s: when it came, by a steady clock of ours.
        """
        if camera_s != self._newest.get(camera):
            self._newest[camera] = camera_s
            self._seen.setdefault(camera, deque(maxlen=REMEMBERED)).append(camera_s - arrived_s)

    def known(self, cameras: Sequence[str]) -> bool:
        """Enough is known of each."""
        return all(len(self._seen.get(camera, ())) >= ENOUGH for camera in cameras)

    def ahead_ns(self, camera: str, *, of: str) -> int | None:
        """By how much the clock of `camera` is ahead of that `of` another, nanoseconds; 0 where they agree, None where
        too little is known.
        """
        if not self.known((camera, of)):
            return None
        ahead_ns = round((max(self._seen[camera]) - max(self._seen[of])) * 1e9)
        return 0 if abs(ahead_ns) < AGREE_NS else ahead_ns
