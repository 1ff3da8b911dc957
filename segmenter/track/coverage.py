"""How much of the belt was really looked at.

A piece of belt passes the centre row unlooked-at when, between two processed frames, the belt moved on by more than
the view less one tuber: what lay there was whole in neither of them. After a restart what the dead process saw is gone
with it, but for what it logged: only the view beyond the centre row can make good for that, as far as a tuber is whole
in it. What stands high leaves the view sooner. Where the load jumps back as no belt does, as much belt may have passed
unseen: what had lain there is followed no more, and what passes next was taken for belt that had passed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from segmenter.track.constants import LONGEST_TUBER_M, USUAL_TUBER_M
from segmenter.track.travel import EarlierMove


@dataclass(slots=True)
class Coverage:
    """Belt length that passed the centre row since the start, and the part of it that was looked at, metres.

    `view_m` of the belt is in view; what stands as high as tubers do is so for `beyond_m` beyond the centre row.
    """

    view_m: float
    beyond_m: float
    looked_at_m: float = 0.0
    travelled_m: float = 0.0
    _highest_m: float | None = None
    _torn_m: float = 0.0
    _resumed: bool = False

    @property
    def _reach_m(self) -> float:
        """So much may pass between two frames and be whole in one of them."""
        return max(0.0, self.view_m - LONGEST_TUBER_M)

    @property
    def _reach_beyond_m(self) -> float:
        """So much of what a dead process saw may lie beyond the centre row and be whole there."""
        return max(0.0, self.beyond_m - USUAL_TUBER_M / 2)

    def step(self, travel_m: float, *, torn_m: float = 0.0) -> None:
        """Take the travel of one more processed frame. Belt that runs back and forth is counted once. `torn_m`: how far
        the load has jumped back in all.
        """
        self.travelled_m += torn_m - self._torn_m
        self._torn_m = torn_m
        if self._highest_m is None:
            self._highest_m = travel_m
            return
        moved_m = travel_m - self._highest_m
        if moved_m <= 0:
            return
        self._highest_m = travel_m
        self.travelled_m += moved_m
        self.looked_at_m += min(moved_m, self._reach_beyond_m if self._resumed else self._reach_m)
        self._resumed = False

    def earlier(self, moves: Iterable[EarlierMove]) -> None:
        """Belt that had moved before its travel could be told. It was looked at where it was bare: load on it was
        followed from no frame to the next, and is not counted. Where it ran backwards none of it is counted.
        """
        for move in moves:
            if move.moved_m <= 0:
                continue
            self.travelled_m += move.all_m
            self.looked_at_m += move.times * min(move.moved_m, self._reach_m) if move.bare else 0.0
            self._highest_m = (self._highest_m or 0.0) + move.all_m

    def resume(self, *, looked_at_m: float, travelled_m: float, travel_m: float) -> None:
        """Carry on from the figures of an earlier process of the same run, which logged all up to `travel_m`."""
        self.looked_at_m, self.travelled_m, self._highest_m = looked_at_m, travelled_m, travel_m
        self._resumed = True
