"""Where an encoder's travel counts from: all cameras of a line have one zero, and a run has it to its end.

A counter knows nothing of runs: it may be anywhere when one begins, and has lost its count after a power cut. So the
travel of a run begins at 0 where no camera has seen the belt yet, and goes on from where the load has brought it where
one has: that is what the segmenters say, from their logs on. Nothing here reads a clock.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from enum import StrEnum

from conveyor.clock_delay import ClockDelay
from conveyor.messages import FrameProgress, Travel

WAIT_FOR_REST_NS = 5_000_000_000
"""Cameras that say nothing so long after the first one has spoken are not there."""
YOUNGEST_NS, OLDEST_NS = -50_000_000, 1_000_000_000
"""Where the quickest of a camera's words come so soon after their frames were taken, its clock is taken for ours."""
WORDS, SURE_AFTER = 50, 5
"""Words of a camera that are compared, and after how many of them its clock is taken for another. On a machine that is
too slow one alone may come late: taken for a word of now, it laid the belt a second back."""
STEP_NS = 5_000_000_000


class Standing(StrEnum):
    """Whether the encoder tells travel."""

    ASKING = "asking"
    TELLS = "tells"
    LATE = "late"
    """The run goes on by the load, as it began: places counted from two zeros would not fit together."""


class Zero:
    """Finds the zero of a run.

    Args:
        run: its id; what is said of others is not heard.
        cameras: names of the live ones.
    """

    def __init__(self, run: str, cameras: Collection[str]) -> None:
        self._run, self.cameras = run, tuple(sorted(cameras))
        self.standing = Standing.ASKING
        self.zero_m = 0.0
        self._delays = {camera: ClockDelay(kept=WORDS, step_ns=STEP_NS) for camera in self.cameras}
        self.ask()

    def ask(self) -> None:
        """The counter lost its count: from here on only what is said of frames since then counts."""
        if self.standing is not Standing.LATE:
            self.standing = Standing.ASKING
        self._fresh: set[str] = set()
        self._offsets_m: dict[str, float] = {}
        self._first_ns: int | None = None

    def progress(self, said: FrameProgress) -> None:
        """A segmenter says how far its camera's run got: nowhere yet, perhaps."""
        if said.run == self._run and said.camera in self.cameras:
            if said.done_seq < 0:
                self._fresh.add(said.camera)
            else:
                self._fresh.discard(said.camera)

    def travel(self, said: Travel, *, clock_ns: int, turned_at: Callable[[int], float | None]) -> None:
        """A segmenter says where the belt was in one of its frames. Each is to be heard, as it comes.

        Args:
            clock_ns: the time of the day, as the encoder's process has it.
            turned_at: how far the shaft had turned at such a time, metres; None before it was first read.
        """
        if said.run != self._run or said.source not in self.cameras:
            return
        delay = self._delays[said.source]
        delay.heard(clock_ns - said.captured_ns)
        if self.standing is not Standing.ASKING:
            return
        if said.estimated:
            self.standing = Standing.LATE
            return
        quickest_ns = delay.quickest_ns or 0
        own = YOUNGEST_NS <= quickest_ns <= OLDEST_NS
        if not own and len(delay) < SURE_AFTER:
            return
        turned_m = turned_at(said.captured_ns + (0 if own else quickest_ns))
        if turned_m is not None:
            self._offsets_m[said.source] = said.travel_m - turned_m

    def decide(self, now_ns: int, turned_m: float) -> bool:
        """Lay the zero, once every camera has spoken; True where it was laid now. `now_ns`: monotonic."""
        if self.standing is not Standing.ASKING:
            return False
        spoken = self._fresh | set(self._offsets_m)
        if not spoken:
            return False
        self._first_ns = now_ns if self._first_ns is None else self._first_ns
        if len(spoken) < len(self.cameras) and now_ns - self._first_ns < WAIT_FOR_REST_NS:
            return False
        begun = [self._offsets_m[name] for name in self._offsets_m if name not in self._fresh]
        # Never behind what one of them has seen: places told twice would be taken for the same belt.
        self.zero_m = max([*begun, *([-turned_m] if self._fresh else [])])
        self.standing = Standing.TELLS
        return True
