"""A recording that plays as a camera does: by the clock, whether or not anyone takes its frames."""

from __future__ import annotations

import time
from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise
from typing import Protocol

from camera_sim.flow import LONGEST_STEP_S
from conveyor.formats import CameraDescription, Refused
from conveyor.formats.source import FrameKey, RecordedSource
from conveyor.messages import Frame

BEHIND_S = 0.5
"""A device keeps this much of its newest frames; what is older when it is asked for is gone."""
LOOK_EVERY_S = 0.02
AT_ONCE_S = 0.002
SOON_S = 60.0
"""A recording that begins later, or was over earlier, is told."""


class Clock(Protocol):
    """What the module `time` has."""

    def monotonic(self) -> float:
        """Seconds that never jump."""
        ...

    def time(self) -> float:
        """Seconds since 1970."""
        ...

    def time_ns(self) -> int:
        """Nanoseconds since 1970."""
        ...

    def sleep(self, seconds: float, /) -> None:
        """Wait."""
        ...


class ClockedSource:
    """Frames of `inner` when their time has come, the first one at `starts_at_s` (seconds since 1970), stamped with the
    time of the day as a device does.

    What a process that starts late, was stopped or killed did not take meanwhile is gone, and a gap in the numbers.
    Only the newest frame stays, as with a camera over a belt that stopped.
    """

    def __init__(self, inner: RecordedSource, *, starts_at_s: float, speed: float, clock: Clock = time) -> None:
        self._inner = inner
        self._clock = clock
        self._starts_s = clock.monotonic() + starts_at_s - clock.time()
        self._speed = speed
        self._poll: Callable[[float], bool] = lambda still_s: True
        self._description = replace(inner.description, live=True)
        if untimely := self._untimely(starts_at_s):
            self._description = replace(self._description, notes=(*inner.description.notes, untimely))

    @property
    def description(self) -> CameraDescription:
        """As recorded, but live."""
        return self._description

    def attach(self, poll: Callable[[float], bool]) -> None:
        """While nothing comes, `poll` is told several times a second for how long (seconds); False ends the frames."""
        self._poll = poll

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """Frames above `after` as they come due."""
        keys = self._inner.keys()
        if not keys:
            return
        due_s = [self._starts_s + passed_s / self._speed for passed_s in self._passed_s(keys)]
        seqs = [key.seq for key in keys]
        at = bisect_left(seqs, after + 1)
        while at < len(keys):
            at = asked = max(at, min(bisect_left(due_s, self._clock.monotonic() - BEHIND_S), len(keys) - 1))
            for item in self._inner.frames(run=run, after=seqs[at] - 1):
                if not self._wait(due_s[at]):
                    return
                late_s = self._clock.monotonic() - due_s[at]
                # What was there when it was asked for is given out, however long that took: else on a machine that is
                # slow enough nothing ever is.
                if asked < at < len(keys) - 1 and late_s > BEHIND_S:
                    break  # go on where the recording has come to
                yield item if isinstance(item, Refused) else replace(item, captured_ns=self._day_time_ns(due_s[at]))
                at += 1
            else:
                return

    def _untimely(self, starts_at_s: float) -> str:
        """That nothing of it comes for long, or that all of it is over, in words; empty where it is neither."""
        ahead_s = self._starts_s - self._clock.monotonic()
        told = f"starts_at_s = {starts_at_s:.0f} is {datetime.fromtimestamp(starts_at_s, UTC):%Y-%m-%d %H:%M:%S} UTC"
        if ahead_s > SOON_S:
            return f"{told}: its first frame comes in {ahead_s / 3600:.1f} h"
        keys = self._inner.keys()
        over_s = -ahead_s - (max(self._passed_s(keys)) / self._speed if keys else 0.0)
        return f"{told}: it was over {over_s / 3600:.1f} h ago, only its last frame comes" if over_s > SOON_S else ""

    def _passed_s(self, keys: list[FrameKey]) -> Iterator[float]:
        """Seconds from the first frame to each. A recorded clock that was set back takes no time, one that was set
        ahead no more than `Pace` gives it; frames that are missing by their numbers take theirs.
        """
        passed_s = 0.0
        for before, key in pairwise([keys[0], *keys]):
            most_s = max(LONGEST_STEP_S, (key.seq - before.seq) / self._description.fps)
            passed_s += min(max((key.captured_ns - before.captured_ns) / 1e9, 0.0), most_s)
            yield passed_s

    def _wait(self, until_s: float) -> bool:
        since_s = self._clock.monotonic()
        while (left_s := until_s - self._clock.monotonic()) > 0:
            if not self._poll(self._clock.monotonic() - since_s):
                return False
            self._clock.sleep(min(left_s, LOOK_EVERY_S))
        return self._poll(0.0)

    def _day_time_ns(self, at_s: float) -> int:
        """The time of the day at a moment of the monotonic clock; both are read at once, or again."""
        while True:
            before_s, now_ns = self._clock.monotonic(), self._clock.time_ns()
            if self._clock.monotonic() - before_s < AT_ONCE_S:
                return now_ns - round((before_s - at_s) * 1e9)
