"""How much of a line is shown: measured bytes per second of each profile stand in docs/viewer.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ProfileName = Literal["light", "remote", "full"]


@dataclass(frozen=True, slots=True)
class Profile:
    """What one profile subscribes to and how much of it is drawn.

    Attributes:
        pictures: subscribe to frames and views at all; without them no heavy byte reaches this process.
        stride: every `stride`-th pixel of every `stride`-th row. Striding, not averaging: means of a tuber's edge and
            the belt are points that exist nowhere.
        rate_hz: at most so many pictures per second of capture time and camera, and belt positions per second.
        cloud_points: at most so many points of one tuber.
        best_views_only: draw the best view of a tuber and leave out the others.
    """

    name: ProfileName
    pictures: bool
    stride: int
    rate_hz: int
    cloud_points: int
    best_views_only: bool


PROFILES: dict[ProfileName, Profile] = {
    "light": Profile("light", False, 1, 5, 0, True),
    "remote": Profile("remote", True, 2, 5, 800, True),
    "full": Profile("full", True, 1, 60, 5000, False),
}
