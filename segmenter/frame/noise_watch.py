"""How noisy a camera's depth is, looked at every second in a run: what the weights are told with each view."""

from __future__ import annotations

from collections import deque
from statistics import median

from conveyor.camera_range import BASELINE_M
from conveyor.depth_noise import disparity, noise_px
from conveyor.messages import Frame
from segmenter.frame.constants import CHECK_EVERY

KEPT = 5
"""Looks that the median is taken of: a hand in one frame is no noisy camera."""


class NoiseWatch:
    """The local noise of one camera in pixels of disparity at a baseline of 18 mm, whatever the camera's own is.

    It looks at processed frames by their count, so a replay measures what it measured before.
    """

    def __init__(self) -> None:
        self._frames = 0
        self._seen_px: deque[float] = deque(maxlen=KEPT)

    def step(self, frame: Frame) -> None:
        """Take the next processed frame."""
        if self._frames % CHECK_EVERY == 0 and frame.depth.any():
            strength = frame.intrinsics.fx * BASELINE_M
            found = noise_px(disparity(frame.depth, depth_scale_m=frame.depth_scale_m, focal_baseline=strength))
            if found is not None:
                self._seen_px.append(found)
        self._frames += 1

    @property
    def noise_px(self) -> float | None:
        """The median of the last looks; None before the first."""
        return float(median(self._seen_px)) if self._seen_px else None
