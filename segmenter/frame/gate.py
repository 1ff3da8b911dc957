"""Which frames cannot be processed: the camera sees nothing, or shows a still picture of a moving belt."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.messages import Frame
from conveyor.reasons import FrameDrop
from segmenter.frame.constants import FROZEN_M, LEAST_SEEN_OF_FRAME, SAME_POSE


class FrameGate:
    """Checks each frame against the first one of the run that this process saw, whose geometry it works with, and the
    last one that was processed. A process that goes on with the run takes the camera that it finds: a broken one may be
    replaced within a run, and that is told by the ledger, which knows all cameras that it had.

    Attributes:
        changed: what of the newest frame is not as in the first one, with both values; empty where all is.
        stood: most processed frames in a row that were one picture of a load, while no encoder told of the belt.
    """

    def __init__(self) -> None:
        self.changed = ""
        self.stood = 0
        self._standing = 0
        self._first: Frame | None = None
        self._last: Frame | None = None
        self._last_had_load = False

    def drop(self, frame: Frame) -> FrameDrop | None:
        """Why a frame cannot be processed; None where it can.

        Where it was taken with other intrinsics, in another depth unit or from another pose than the first, its heights
        and places would be wrong.
        """
        first = self._first = self._first or frame
        self.changed = _changed(frame, first)
        if self.changed:
            return FrameDrop.CAMERA_CHANGED
        if frame.mask is None and _is_blind(frame):
            return FrameDrop.BLIND
        return FrameDrop.FROZEN if self._frozen(frame) else None

    def processed(self, frame: Frame, *, instances: int) -> None:
        """A frame was processed, and `instances` were found on it."""
        last = self._last
        again = last is not None and frame.travel_m is None and self._last_had_load and _same(frame.depth, last.depth)
        self._standing = self._standing + 1 if again else 0
        self.stood = max(self.stood, self._standing)
        self._last, self._last_had_load = frame, instances > 0

    def _frozen(self, frame: Frame) -> bool:
        """The picture stands still though the belt moved on. An empty belt may look the same in every frame."""
        last = self._last
        if last is None or frame.travel_m is None or last.travel_m is None or not self._last_had_load:
            return False
        return abs(frame.travel_m - last.travel_m) >= FROZEN_M and _same(frame.depth, last.depth)


def _changed(frame: Frame, first: Frame) -> str:
    if frame.intrinsics != first.intrinsics:
        return f"intrinsics {frame.intrinsics} and not {first.intrinsics}"
    if frame.depth_scale_m != first.depth_scale_m:
        return f"depth unit {frame.depth_scale_m:g} m and not {first.depth_scale_m:g} m"
    pose, first_pose = frame.belt_from_camera, first.belt_from_camera
    if pose is None or first_pose is None:
        return "" if pose is first_pose else "a pose (belt_from_camera) in one of both only"
    if np.abs(pose - first_pose).max() <= SAME_POSE:
        return ""
    return f"pose (belt_from_camera) {pose[:3].round(4).tolist()} and not {first_pose[:3].round(4).tolist()}"


def _same(depth: NDArray[np.uint16], last: NDArray[np.uint16]) -> bool:
    """Both pictures are one. A row of noise differs as a rule: all others are looked at only where it does not."""
    row = slice(len(depth) // 2, len(depth) // 2 + 1)
    return np.array_equal(depth[row], last[row]) and np.array_equal(depth, last)


def _is_blind(frame: Frame) -> bool:
    return bool(np.count_nonzero(frame.depth) < LEAST_SEEN_OF_FRAME * frame.depth.size)
