"""Where a camera hangs over the belt, in the words of a person with a tape measure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conveyor.geometry import inverse_rigid, straight_down_belt_from_camera


@dataclass(frozen=True, slots=True)
class CameraPlace:
    """A camera over the belt, but for its height and tilt.

    Attributes:
        along_m: how far down the belt its optical centre is, positive with the travel.
        across_m: how far across, positive to the left of who looks along the travel.
        turned_deg: from the travel to the image's downward direction, counter-clockwise as seen from above: at 0 the
            belt runs down the image, at 180 up, at 90 and -90 across it.
    """

    along_m: float = 0.0
    across_m: float = 0.0
    turned_deg: float = 0.0

    @classmethod
    def of(cls, belt_from_camera: NDArray[np.float64]) -> CameraPlace:
        """That of a (4, 4) pose, whatever its tilt."""
        m = belt_from_camera
        return cls(float(m[0, 3]), float(m[1, 3]), math.degrees(math.atan2(m[1, 1], m[0, 1])))

    def straight_down(self, belt_distance_m: float) -> NDArray[np.float64]:
        """(4, 4) `belt_from_camera` of a camera here that looks straight down."""
        return self._moved() @ straight_down_belt_from_camera(belt_distance_m)

    def put(self, belt_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
        """(4, 4) pose of that camera hung here, at the height and with the tilt that it has."""
        there = CameraPlace.of(belt_from_camera)._moved()
        pose: NDArray[np.float64] = self._moved() @ inverse_rigid(there) @ belt_from_camera
        return pose

    def _moved(self) -> NDArray[np.float64]:
        """(4, 4) from the origin to here, along the belt's plane."""
        angle = math.radians(self.turned_deg)
        moved = np.eye(4)
        moved[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
        moved[:2, 3] = self.along_m, self.across_m
        return moved
