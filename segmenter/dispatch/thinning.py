"""Fewer frames where the regressors cannot keep up: looking costs the machine what weighing needs.

Only as many are left out as leave every tuber seen several times on its way through the view.
"""

from __future__ import annotations

from dataclasses import dataclass

LOOK_EVERY_M = 0.06
"""The belt is looked at at least this often: views are 0.38 to 0.51 m long, so that a tuber is whole in four frames."""


@dataclass(slots=True)
class Thinning:
    """When and where the belt was last looked at, in capture time and travel."""

    _last: tuple[int, float] | None = None
    _speed_m_ns: float = 0.0
    _newest_ns: int = 0

    def looked(self, captured_ns: int, travel_m: float) -> None:
        """A frame was processed; the belt stood at `travel_m`."""
        if self._last is not None and captured_ns > self._last[0]:
            self._speed_m_ns = abs(travel_m - self._last[1]) / (captured_ns - self._last[0])
        self._last = (captured_ns, travel_m)
        self._newest_ns = captured_ns

    def spares(self, captured_ns: int) -> bool:
        """The frame may be left out: by the one after it the belt will have moved on by less than `LOOK_EVERY_M`."""
        before_ns, self._newest_ns = self._newest_ns, captured_ns
        if self._last is None or self._speed_m_ns == 0.0 or captured_ns <= before_ns:
            return False
        next_ns = 2 * captured_ns - before_ns
        return self._speed_m_ns * (next_ns - self._last[0]) <= LOOK_EVERY_M
