"""A recording as ROS 2 topics in MCAP, for ROS and Foxglove tools; what ROS cannot say stands beside it.

Topics per camera: `/<camera>/depth/image_rect_raw` (Image, 16UC1 in millimetres; 32FC1 in metres where the unit is
another), `/<camera>/depth/camera_info`, and where the recording has them `/<camera>/color/image_raw/compressed` (JPEG),
`/<camera>/mask/image_raw` (mono16 labels) and `/<camera>/belt/travel` (Float64, metres). The messages of one frame
carry its number as MCAP sequence, depth last. The metadata record `tuberline` holds each camera's
camera.json by its depth topic: name, depth unit, belt distance and frame rate.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

PROFILE = "ros2"
METADATA = "tuberline"
MILLIMETRE_M = 0.001


@dataclass(frozen=True, slots=True)
class CameraTopics:
    """The topics of one exported camera; `root` is its name in ROS."""

    root: str

    @property
    def depth(self) -> str:
        """Image of the depth."""
        return f"/{self.root}/depth/image_rect_raw"

    @property
    def info(self) -> str:
        """CameraInfo of the depth."""
        return f"/{self.root}/depth/camera_info"

    @property
    def color(self) -> str:
        """CompressedImage of the colour."""
        return f"/{self.root}/color/image_raw/compressed"

    @property
    def mask(self) -> str:
        """Image of the instance labels."""
        return f"/{self.root}/mask/image_raw"

    @property
    def travel(self) -> str:
        """Float64 of the belt's travel."""
        return f"/{self.root}/belt/travel"

    @property
    def frame_id(self) -> str:
        """Name of the camera's optical frame."""
        return f"{self.root}_depth_optical_frame"


def topics_of_camera(camera: str) -> CameraTopics:
    """Topics of the camera `camera`; ROS names have letters, digits and underscores, and begin with a letter."""
    root = re.sub(r"[^A-Za-z0-9_]", "_", camera)
    return CameraTopics(root if root[0].isalpha() else f"camera_{root}")


def topics_of_depth(depth_topic: str) -> CameraTopics:
    """Topics of the camera whose depth topic this is."""
    return CameraTopics(depth_topic.split("/")[1])
