"""Frames of a camera that is mounted a quarter turn round, so that the belt runs along its image's columns.

Tubers are counted where they cross the image's centre row; turned by 90 degrees, such a camera is one like all others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.formats.source import CameraDescription
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame

ALONG_ROWS = 0.5
"""From this share of the belt's travel along the image's rows on, nothing is turned."""

Image = TypeVar("Image", np.uint8, np.uint16)


@dataclass(frozen=True, slots=True)
class QuarterTurn:
    """Turns images a quarter: counter-clockwise for `quarters` 1, clockwise for -1."""

    quarters: int

    def description(self, d: CameraDescription) -> CameraDescription:
        """Of the turned camera."""
        return replace(d, intrinsics=self._intrinsics(d.intrinsics), belt_from_camera=self._pose(d.belt_from_camera))

    def frame(self, frame: Frame) -> Frame:
        """The same belt in an image whose rows it runs along."""
        return replace(
            frame,
            intrinsics=self._intrinsics(frame.intrinsics),
            belt_from_camera=self._pose(frame.belt_from_camera),
            depth=self._image(frame.depth),
            mask=None if frame.mask is None else self._image(frame.mask),
            color_jpeg=None if frame.color_jpeg is None else self._jpeg(frame.color_jpeg),
        )

    def recorded_pose(self, belt_from_turned: NDArray[np.float64]) -> NDArray[np.float64]:
        """(4, 4) `belt_from_camera` of the camera as it was recorded, from that of the turned one."""
        recorded: NDArray[np.float64] = belt_from_turned @ self._camera_from_turned().T
        return recorded

    def _intrinsics(self, k: Intrinsics) -> Intrinsics:
        cx, cy = (k.cy, k.width - 1 - k.cx) if self.quarters == 1 else (k.height - 1 - k.cy, k.cx)
        return Intrinsics(k.height, k.width, k.fy, k.fx, cx, cy)

    def _pose(self, belt_from_camera: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
        if belt_from_camera is None:
            return None
        turned: NDArray[np.float64] = belt_from_camera @ self._camera_from_turned()
        return turned

    def _camera_from_turned(self) -> NDArray[np.float64]:
        camera_from_turned = np.eye(4)
        camera_from_turned[:2, :2] = [[0, -self.quarters], [self.quarters, 0]]
        return camera_from_turned

    def _image(self, image: NDArray[Image]) -> NDArray[Image]:
        return np.ascontiguousarray(np.rot90(image, self.quarters))

    def _jpeg(self, jpeg: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
        """Colour is only looked at, so it may be encoded again; what cannot be read is left out."""
        image = cv2.imdecode(jpeg, cv2.IMREAD_COLOR) if jpeg.size else None
        if image is None:
            return None
        turned = np.rot90(image, self.quarters)
        return np.asarray(cv2.imencode(".jpg", turned, [cv2.IMWRITE_JPEG_QUALITY, 90])[1], np.uint8).ravel()


def quarter_turn(belt_from_camera: NDArray[np.float64] | None) -> QuarterTurn | None:
    """The turn that makes the belt run down the image's rows; None where it runs along them already."""
    if belt_from_camera is None or abs(belt_from_camera[0, 1]) >= ALONG_ROWS:
        return None
    along_columns = float(belt_from_camera[0, 0])
    if abs(along_columns) < ALONG_ROWS:
        return None
    return QuarterTurn(1 if along_columns < 0 else -1)
