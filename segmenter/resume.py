"""Where an earlier process of the same run left off, and what its successor can say of the belt since."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from conveyor.camera_clock import STANDS_AFTER_S
from conveyor.messages import Frame, Mark, Track
from conveyor.messages.tracks import CARRIED, UNFOLLOWED

SEEN_AGAIN_M = 0.005
"""Twice as far as the places differ that two processes find for one tuber."""


@dataclass(frozen=True, slots=True)
class Resume:
    """All that crossed at or before `complete` is in the log.

    `travel_m` is what it saw last, at `captured_ns`; what had crossed since `complete` it took with it. `speed_mps` is
    the belt's last speed, for where no encoder says how far it went since; None: not known. `unfollowed_ms` is how long
    load passed of which it did not know how far it moved, `carried_ms` how long it saw no load move
    (`TravelEstimator`). `by_encoder`: an encoder told it where the belt was. `logged_x_m` is the place of the last
    tuber it logged; None: there was none.
    """

    complete_ns: int
    complete_place_x_m: float
    travel_m: float
    looked_at_m: float
    travelled_m: float
    captured_ns: int = 0
    speed_mps: float | None = None
    unfollowed_ms: int = 0
    carried_ms: int = 0
    by_encoder: bool = False
    logged_x_m: float | None = None

    def unlogged_m(self, row_x_m: float) -> float:
        """Belt that had passed the centre row, at `row_x_m`, since counting began and is not in the log."""
        unlogged_m = self.travel_m - (row_x_m - self.complete_place_x_m)
        return min(max(0.0, unlogged_m), self.travelled_m)

    def missed_m(self, captured_ns: int) -> float:
        """Belt that went by unseen until `captured_ns`, at the last speed; 0 where that is not known."""
        return (self.speed_mps or 0.0) * self._gap_s(captured_ns)

    def _gap_s(self, captured_ns: int) -> float:
        """Seconds that no process looked; 0 where the clock says nothing."""
        return min(max(0.0, (captured_ns - self.captured_ns) * 1e-9), STANDS_AFTER_S)

    def at_first(self, frame: Frame) -> Resume:
        """Where counting goes on at the first frame over a known belt.

        An encoder says where the belt is. The mark ends right before the first tuber that was not logged, and its
        successor sees that one a millimetre or two elsewhere: counting goes on `SEEN_AGAIN_M` before the mark, and what
        is logged twice so is one tuber to the ledger. Where none says it, see `brought_to`.
        """
        if self.by_encoder and frame.travel_m is not None:
            return replace(self, complete_place_x_m=self.complete_place_x_m + SEEN_AGAIN_M)
        return self.brought_to(frame.captured_ns)

    def brought_to(self, captured_ns: int) -> Resume:
        """The same as of the first frame, which no encoder tells of: the belt has run on, and no process looked at it.

        What was logged is told from what was not by its place alone, which is a guess then: counting goes on beyond all
        of it, and the travel at which it does moves with the belt. So whatever the belt really did, no tuber that was
        logged is counted again, and those that crossed meanwhile count as belt not looked at. Where no speed is known
        yet, that belt is told once there is one.
        """
        if self.logged_x_m is not None and self.logged_x_m < self.complete_place_x_m:
            return replace(self, complete_place_x_m=self.logged_x_m).brought_to(captured_ns)
        gap_ms = round(1000 * self._gap_s(captured_ns))
        if gap_ms == 0:
            return self
        carried_ms, missed_m = self.carried_ms + gap_ms, self.missed_m(captured_ns)
        if self.speed_mps is None:
            return replace(self, unfollowed_ms=self.unfollowed_ms + gap_ms, carried_ms=carried_ms)
        if missed_m <= 0:
            return replace(self, carried_ms=carried_ms)
        return replace(
            self,
            carried_ms=carried_ms,
            complete_ns=self.complete_ns + captured_ns - self.captured_ns,
            complete_place_x_m=self.complete_place_x_m - missed_m,
            travel_m=self.travel_m + missed_m,
            travelled_m=self.travelled_m + missed_m,
            captured_ns=captured_ns,
        )


def resume_after(mark: Mark, logged: Sequence[Track], speed_mps: float | None) -> Resume:
    """Where the process that wrote `mark`, and the tracks `logged` after it, left off."""
    return Resume(
        complete_ns=mark.complete_ns,
        complete_place_x_m=mark.complete_place_x_m,
        by_encoder=not mark.travel_estimated,
        logged_x_m=min((track.place_x_m for track in logged), default=None),
        travel_m=mark.travel_m,
        looked_at_m=mark.looked_at_m,
        travelled_m=mark.travelled_m,
        captured_ns=mark.captured_ns,
        speed_mps=speed_mps,
        unfollowed_ms=mark.frames.get(UNFOLLOWED, 0),
        carried_ms=mark.frames.get(CARRIED, 0),
    )
