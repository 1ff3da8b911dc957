"""How old a live frame is, though the camera's clock and ours need not agree."""

from __future__ import annotations

from dataclasses import dataclass, field

from conveyor.clock_delay import ClockDelay

CLOCK_JUMP_NS = 5_000_000_000
REMEMBERED = 300


@dataclass(slots=True)
class FrameAge:
    """Age of frames beyond the quickest of the last ones: what they waited on the way, not what the clocks differ.

    `speed`: how many times faster than its clock says a recording is sent; 0: at once, so that nothing can be said.
    """

    speed: float = 1.0
    _delay: ClockDelay = field(default_factory=lambda: ClockDelay(kept=REMEMBERED, step_ns=CLOCK_JUMP_NS))

    @property
    def quickest_ns(self) -> int | None:
        """Our clock minus the camera's, with the way of the quickest of the last frames; None before the first."""
        return self._delay.quickest_ns if self.speed == 1.0 else None

    def age_ms(self, captured_ns: int, arrived_ns: int) -> float:
        """Milliseconds that this frame is later than the quickest one. A jump of the camera's clock starts over."""
        if self.speed <= 0:
            return 0.0
        delay_ns = arrived_ns - (captured_ns if self.speed == 1.0 else round(captured_ns / self.speed))
        self._delay.heard(delay_ns)
        return (delay_ns - (self._delay.quickest_ns or 0)) / 1e6
