"""What CameraInfo says of each image of a ROS 2 camera: its driver may start again in another mode during a run."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from camera_sim.live.rmw_zenoh import read_attachment
from conveyor.errors import InputError, MessageError
from conveyor.formats.png16 import Refusal
from conveyor.formats.rosbag.bags import decode_ros
from conveyor.formats.rosbag.depth import intrinsics_of
from conveyor.formats.rosbag.messages import RosCalibration
from conveyor.geometry import Intrinsics

INFO = "sensor_msgs/msg/CameraInfo"
KEPT = 16
"""Newest CameraInfos in which an image looks for its own, by its time stamp; longer than the queue of images."""
DOUBTED_IMAGES = 30
"""Images of a driver that started again that wait for a new CameraInfo. Where none comes, who publishes it did not
start again, and what it said holds."""


@dataclass(frozen=True, slots=True)
class _Said:
    stamp_ns: int
    publisher: bytes
    intrinsics: Intrinsics | Refusal


class Calibrations:
    """CameraInfos as they come, and the one that belongs to an image.

    Args:
        topic: where they come from, for what is refused.
        rectified: the images are, so P counts and not K.
    """

    def __init__(self, topic: str, *, rectified: bool) -> None:
        self._topic = topic
        self._rectified = rectified
        self._said: deque[_Said] = deque(maxlen=KEPT)
        self._images_from: bytes | None = None
        self._told_by = b""
        self._doubted = 0

    def take(self, payload: bytes, attachment: bytes = b"") -> None:
        """The newest CameraInfo; one that cannot be used makes its images such, too."""
        try:
            publisher = read_attachment(attachment).gid
        except MessageError:
            publisher = b""
        try:
            found = decode_ros(INFO, payload)
            assert isinstance(found, RosCalibration)
            said = _Said(found.stamp_ns, publisher, self._intrinsics(found))
        except (InputError, MessageError) as error:
            refusal = Refusal("camera_info", f"has a CameraInfo that cannot be used: {error}")
            said = _Said(0, publisher, refusal)
        self._said.append(said)
        self._doubted = 0

    def of_image(self, stamp_ns: int, *, publisher: bytes) -> Intrinsics | Refusal:
        """Intrinsics of the image with this stamp, by the node `publisher`; `take` must have been called."""
        newest = self._said[-1]
        if publisher != self._images_from:
            again = self._images_from is not None and newest.publisher == self._told_by
            self._images_from, self._doubted = publisher, DOUBTED_IMAGES if again else 0
        if self._doubted:
            self._doubted -= 1
            return Refusal("camera_info", f"is of a driver that started again, and {self._topic} said nothing since")
        self._told_by = newest.publisher
        return next((one.intrinsics for one in self._said if one.stamp_ns == stamp_ns != 0), newest.intrinsics)

    def _intrinsics(self, found: RosCalibration) -> Intrinsics:
        return intrinsics_of(found, rectified=self._rectified, where=f"topic {self._topic}")
