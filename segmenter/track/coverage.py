"""How much of the belt was really looked at.

A piece of belt passes the centre row unlooked-at when, between two processed frames, the belt moved on by more than
the view less one tuber: what lay there was whole in neither of them. After a restart what the dead process saw is gone
with it, but for what it logged: only the half of the view beyond the centre row can make good for that.
"""

from __future__ import annotations

from dataclasses import dataclass

from segmenter.track.constants import LONGEST_TUBER_M


@dataclass(slots=True)
class Coverage:
    """Belt length that passed the centre row since the start, and the part of it that was looked at, metres."""

    view_m: float
    looked_at_m: float = 0.0
    travelled_m: float = 0.0
    _highest_m: float | None = None
    _resumed: bool = False

    def step(self, travel_m: float) -> None:
        """Take the travel of one more processed frame. Belt that runs back and forth is counted once."""
        if self._highest_m is None:
            self._highest_m = travel_m
            return
        moved_m = travel_m - self._highest_m
        if moved_m <= 0:
            return
        self._highest_m = travel_m
        self.travelled_m += moved_m
        reach_m = max(0.0, self.view_m - LONGEST_TUBER_M)
        self.looked_at_m += min(moved_m, reach_m / 2 if self._resumed else reach_m)
        self._resumed = False

    def resume(self, *, looked_at_m: float, travelled_m: float, travel_m: float) -> None:
        """Carry on from the figures of an earlier process of the same run, which logged all up to `travel_m`."""
        self.looked_at_m, self.travelled_m, self._highest_m = looked_at_m, travelled_m, travel_m
        self._resumed = True
