"""How far the belt is seen off its calibration where nothing says why: what each tuber is flagged with."""

from __future__ import annotations

from collections import deque
from statistics import median

from conveyor.camera_flags import belt_off_flag
from segmenter.frame.constants import KEPT_CHECKS
from segmenter.frame.plane import BeltCheck


class BeltOff:
    """The median of the last checks."""

    def __init__(self) -> None:
        self._newest: BeltCheck | None = None
        self._off_m: deque[float] = deque(maxlen=KEPT_CHECKS)

    def step(self, check: BeltCheck) -> None:
        """Take what the core says after one more frame."""
        if check is not self._newest:
            self._newest = check
            if check.drift_m is not None:
                self._off_m.append(check.drift_m)

    def flags(self) -> tuple[str, ...]:
        """How far off, in whole millimetres; nothing where that is little or not known."""
        return belt_off_flag(median(self._off_m)) if self._off_m else ()
