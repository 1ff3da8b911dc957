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
AGREE_S = 0.05
"""Clocks that differ by less agree. 15 mm of belt; and by less they are set by any time server."""

LARGEST_S = 9e9
"""What nanoseconds in 64 bits hold: no camera's clock says more, whatever a report says."""


@dataclass(slots=True)
class CameraClocks:
    """Collects reports, and says by how much each camera's clock is ahead of the first one's."""

    _seen: dict[str, deque[float]] = field(default_factory=dict)
    _newest: dict[str, float] = field(default_factory=dict)
    _hosts: dict[str, str] = field(default_factory=dict)

    def reported(self, camera: str, camera_s: float, *, host: str, arrived_s: float) -> None:
        """A report came. One that is told again, for nothing newer has come, changes nothing, nor does an absurd one.

        Args:
            camera_s: what the camera's clock said when the report was sent, seconds.
            host: where the camera is.
            arrived_s: when it came, by a steady clock of ours.
        """
        if abs(camera_s) <= LARGEST_S and camera_s != self._newest.get(camera):
            self._newest[camera], self._hosts[camera] = camera_s, host
            self._seen.setdefault(camera, deque(maxlen=REMEMBERED)).append(camera_s - arrived_s)

    def known(self, cameras: Sequence[str], *, of: str) -> bool:
        """Of each it is known how far its clock is ahead."""
        return all(self.ahead_ns(camera, of=of) is not None for camera in cameras)

    def ahead_ns(self, camera: str, *, of: str) -> int | None:
        """By how much the clock of `camera` is ahead of that `of` another, nanoseconds; 0 where they agree or are of
        one host, None where too little is known: too few reports, or all so late that the difference may be theirs.
        """
        if camera in self._hosts and self._hosts[camera] == self._hosts.get(of):
            return 0  # whose frames may be half a second late under overload, of one camera more than of the other
        own, other = (sorted(self._seen.get(name, ()), reverse=True) for name in (camera, of))
        if min(len(own), len(other)) < ENOUGH:
            return None
        ahead_s = own[0] - other[0]
        doubt_s = (own[0] - own[ENOUGH - 1]) + (other[0] - other[ENOUGH - 1])
        if abs(ahead_s) < AGREE_S:
            return 0
        return round(ahead_s * 1e9) if abs(ahead_s) > 2 * doubt_s else None
