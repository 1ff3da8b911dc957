"""How a tuber lies and how much of its picture was lost: the classes by which bias is looked at."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from camera_sim.sim.meshes import Vertices
from conveyor.crop_depth import closed

PoseClass = Literal["flat", "tilted", "standing", "unknown"]
RimClass = Literal["exact", "good", "poor"]
FLAT_DEG, STANDING_DEG = 35.0, 45.0
EXACT_RIM, GOOD_RIM = 0.03, 0.10
"""Real partial clouds reach 0.89 to 0.97 of their silhouettes."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Angles of the shortest and the longest axis to the vertical, degrees, 0 to 90; NaN where they are not known."""

    shortest_deg: float
    longest_deg: float

    @property
    def kind(self) -> PoseClass:
        """Standing: the longest axis within 45 degrees of the vertical; flat: the shortest within 35."""
        if math.isnan(self.longest_deg):
            return "unknown"
        if self.longest_deg <= STANDING_DEG:
            return "standing"
        return "flat" if self.shortest_deg <= FLAT_DEG else "tilted"


UNKNOWN_POSE = Pose(math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Rim:
    """What of a silhouette has no depth.

    Attributes:
        lost: share of the visible silhouette outside the outline of what was measured; below 0 where that is larger.
        skin_lost: share of the measured outline's inside that has no depth.
    """

    lost: float
    skin_lost: float

    @property
    def kind(self) -> RimClass:
        """Exact: less than 3 % lost; good: less than 10 %."""
        if self.lost < EXACT_RIM:
            return "exact"
        return "good" if self.lost < GOOD_RIM else "poor"


def pose_of(rotation: Vertices) -> Pose:
    """Of a tuber turned by `rotation` (3, 3), whose axes are x >= y >= z."""
    upright = np.degrees(np.arccos(np.clip(np.abs(rotation[2]), 0.0, 1.0)))
    return Pose(shortest_deg=float(upright[2]), longest_deg=float(upright[0]))


def rim_of(seen: NDArray[np.bool_], silhouette: NDArray[np.bool_]) -> Rim:
    """From where depth was kept (h, w) and the silhouette that a perfect camera sees; the latter must not be empty."""
    inside = int(closed(seen.astype(np.uint8)).sum())
    lost = 1 - inside / int(silhouette.sum())
    return Rim(lost, 1 - int(seen.sum()) / inside if inside else 0.0)
