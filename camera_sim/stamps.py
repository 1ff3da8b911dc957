"""How far the belt had moved when a frame was taken, from what its encoder told before and after. Reads no clock.

Times of two clocks meet here, neither of which need be this machine's: the encoder's, and the camera's. Each is brought
to this process' own monotonic clock by the quickest way that its messages took of late.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from enum import Enum, auto

from conveyor.clock_delay import ClockDelay

KEPT = 400
"""Newest travels, some eight seconds."""
SILENT_NS = 500_000_000
"""Between two travels that lie further apart, and beyond the newest for so long, nothing is known."""
QUICKEST_OF = 200
STEP_NS = 300_000_000
"""A delay that changes by more is a clock that was set, or a process that started again."""
EARLY_NS, LATE_NS = -20_000_000, 250_000_000
"""A camera stamps frames with this machine's clock where the quickest of them come so soon after what they say."""
SURE_AFTER = 10
"""Frames, after which a camera none of whose came so soon has another clock."""


class Known(Enum):
    """What is known of the belt at a moment, where it is not its travel."""

    NOT_YET = auto()
    """What the encoder tells next will say."""
    NEVER = auto()
    """It was silent then."""


class TravelStamps:
    """Travels of the newest seconds, in this process' monotonic time.

    Attributes:
        foreign: the camera's clock is not this machine's: its frames are laid by when they come.
    """

    def __init__(self) -> None:
        self.foreign = False
        self._travels: deque[tuple[int, float]] = deque(maxlen=KEPT)
        self._encoder = ClockDelay(kept=QUICKEST_OF, step_ns=STEP_NS)
        self._camera = ClockDelay(kept=QUICKEST_OF, step_ns=STEP_NS)
        self._ages_ns: deque[int] = deque(maxlen=QUICKEST_OF)
        self._newest_ns: int | None = None

    def told(self, said_ns: int, travel_m: float, now_ns: int) -> None:
        """The encoder told a travel: as of `said_ns` of its clock; it is here now."""
        if not self._encoder.heard(now_ns - said_ns):
            self._travels.clear()
        self._travels.append((said_ns, travel_m))
        self._newest_ns = now_ns

    def taken_ns(self, captured_ns: int, *, day_ns: int, now_ns: int) -> int | None:
        """When a frame that is here now was taken, in monotonic time; None while it is not known by whose clock.

        Args:
            captured_ns: by the camera's clock. day_ns, now_ns: this machine's two clocks, now.
        """
        age_ns = day_ns - captured_ns
        if not self._camera.heard(now_ns - captured_ns):
            self._ages_ns.clear()
        self._ages_ns.append(age_ns)
        own = EARLY_NS <= min(self._ages_ns) <= LATE_NS
        self.foreign = not own and len(self._ages_ns) >= SURE_AFTER
        if self.foreign:
            return captured_ns + (self._camera.quickest_ns or 0)
        return now_ns - max(0, age_ns) if own else None

    def silent_ns(self, now_ns: int) -> int | None:
        """For how long nothing was told; None where nothing ever was."""
        return None if self._newest_ns is None else now_ns - self._newest_ns

    def at(self, taken_ns: int, now_ns: int) -> float | Known:
        """The belt's travel at a moment of monotonic time, metres; linear between what was told."""
        silent_ns = self.silent_ns(now_ns)
        if silent_ns is None:
            return Known.NEVER
        said_ns = taken_ns - (self._encoder.quickest_ns or 0)
        right = bisect_left(self._travels, said_ns, key=lambda told: told[0])
        if right == len(self._travels):
            return Known.NOT_YET if silent_ns < SILENT_NS and now_ns - taken_ns < SILENT_NS else Known.NEVER
        t1, x1 = self._travels[right]
        if t1 == said_ns:
            return x1
        if right == 0:
            return Known.NEVER
        t0, x0 = self._travels[right - 1]
        return Known.NEVER if t1 - t0 > SILENT_NS else x0 + (x1 - x0) * (said_ns - t0) / (t1 - t0)
