"""How far another clock is behind ours, by the quickest of its newest messages. Reads no clock."""

from __future__ import annotations

from collections import deque


class ClockDelay:
    """Our clock minus another one, with the way of its quickest message of late.

    Args:
        kept: newest messages that are compared.
        step_ns: a delay that changes by more from one message to the next is a clock that was set: it starts over.
    """

    def __init__(self, *, kept: int, step_ns: int) -> None:
        self._step_ns = step_ns
        self._delays_ns: deque[int] = deque(maxlen=kept)

    def heard(self, delay_ns: int) -> bool:
        """A message came `delay_ns` after what it says. False: that clock was set."""
        stepped = bool(self._delays_ns) and abs(delay_ns - self._delays_ns[-1]) > self._step_ns
        if stepped:
            self._delays_ns.clear()
        self._delays_ns.append(delay_ns)
        return not stepped

    @property
    def quickest_ns(self) -> int | None:
        """None before the first message."""
        return min(self._delays_ns, default=None)

    def __len__(self) -> int:
        """Messages since the clock was last set, `kept` at most."""
        return len(self._delays_ns)
