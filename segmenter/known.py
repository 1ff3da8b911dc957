"""What a load has said of its camera and its belt, for what counts next: another process, another run, a replay.

What is learned of a camera takes some twenty tubers, and is taken off those that come after. Who knows it before the
first one passes weighs all of them alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from conveyor.geometry import Intrinsics
from conveyor.messages import Frame
from segmenter.classify.prior import Prior
from segmenter.frame.belt import BeltGeometry
from segmenter.outline.compare import Comparison

SAME_DISTANCE = 0.02
"""As a share: a camera that hangs closer or farther by more sees other outlines."""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What is known of one camera.

    Attributes:
        intrinsics, depth_scale_m, belt_distance_m: the camera that it is known of.
        outlines: what pairs of frames say of each tuber's outline (`OutlineWatch`), the newest tuber last.
        flanks_mm: (n, `flanks.BINS`) millimetres by which flanks of each tuber are raised; NaN where nothing is known.
        belt: what the tracks say of clods on the belt, and of how low the camera makes all answers.
    """

    intrinsics: Intrinsics
    depth_scale_m: float
    belt_distance_m: float
    outlines: tuple[tuple[Comparison, ...], ...]
    flanks_mm: NDArray[np.float64]
    belt: Prior

    def unlike(self, frame: Frame, belt: BeltGeometry) -> str:
        """What of the camera is not as it was, in words; empty where all is."""
        if frame.intrinsics != self.intrinsics:
            return "its image or its intrinsics are others"
        if frame.depth_scale_m != self.depth_scale_m:
            return f"its depth unit is {frame.depth_scale_m:g} m and was {self.depth_scale_m:g} m"
        if abs(belt.distance_m / self.belt_distance_m - 1) > SAME_DISTANCE:
            return f"it sees the belt {belt.distance_m:.3f} m away, and saw it {self.belt_distance_m:.3f} m away"
        return ""

    def of_the_camera(self) -> Self:
        """Without what is known of the belt's clods: another day's may carry other soil."""
        return replace(self, belt=Prior(newest=self.belt.newest.copy()))
