"""A frame as people like to see it: small, in colours or as shaded depth, with outlines of what lies on the belt."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.messages import Frame, Outline, Picture
from conveyor.messages.pictures import MAX_PICTURE_BYTES, MOST_CORNERS, MOST_OUTLINES
from conveyor.reasons import TrackRefusal
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.instances import Instances
from segmenter.provisional import ProvisionalWeights
from segmenter.track.foreign import foreign_kind
from segmenter.track.track import State, TrackState

WIDE_PX = 424
FULL_MM = 80.0
"""Height over the belt that is drawn brightest."""
SLOPE_MM = 14.0
"""From one pixel of the picture to the next: a step that is drawn black or white."""
JPEG_QUALITY, POORER_QUALITY = 72, 40
BELT_BGR, SKIN_BGR, TOP_BGR = (74, 66, 58), (70, 150, 205), (205, 236, 255)

Found = Iterable[tuple[TrackState, int]]


def picture_of(
    frame: Frame,
    *,
    belt: BeltGeometry | None,
    instances: Instances | None,
    found: Found,
    weights: ProvisionalWeights,
    drop: str = "",
) -> Picture | None:
    """The picture of a frame, at most `WIDE_PX` wide; None where it cannot be made small enough.

    Args:
        belt: None before it is known: then heights are over the median of the frame.
        instances: of this very frame, with the tracks that they show in `found`; None draws none.
        weights: what tracks weigh so far.
        drop: why the frame was not used.
    """
    stride = -(-frame.intrinsics.width // WIDE_PX)
    image = _colours(frame, stride)
    if image is None:
        image = _shaded(frame, stride, belt)
    jpeg = _jpeg(image)
    if jpeg is None:
        return None
    outlines = () if instances is None else _outlines(frame, instances, found, weights, stride)
    height, width = image.shape[:2]
    return Picture(frame.camera, frame.run, frame.seq, frame.captured_ns, width, height, jpeg, outlines, drop)


def _jpeg(image: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    for quality in (JPEG_QUALITY, POORER_QUALITY):
        done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if done and data.size <= MAX_PICTURE_BYTES:
            return np.asarray(data, np.uint8).ravel()
    return None


def _colours(frame: Frame, stride: int) -> NDArray[np.uint8] | None:
    """(h, w, 3) BGR of the camera's own colours; None where it sends none that can be read."""
    if frame.color_jpeg is None or jpeg_size(frame.color_jpeg) != (frame.intrinsics.width, frame.intrinsics.height):
        return None
    reduced = cv2.IMREAD_REDUCED_COLOR_2 if stride > 1 else cv2.IMREAD_COLOR
    image = cv2.imdecode(frame.color_jpeg, reduced)
    if image is None:
        return None
    size = frame.depth[::stride, ::stride].shape
    return np.asarray(cv2.resize(image, (size[1], size[0]), interpolation=cv2.INTER_AREA), np.uint8)


def jpeg_size(data: NDArray[np.uint8]) -> tuple[int, int] | None:
    """(width, height) that a JPEG file announces, read without decoding it; None where it is no JPEG file."""
    raw = data.tobytes()
    at = 2
    while raw[:2] == b"\xff\xd8" and at + 9 <= len(raw) and raw[at] == 0xFF:
        marker = raw[at + 1]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(raw[at + 7 : at + 9]), int.from_bytes(raw[at + 5 : at + 7])
        at += 2 + int.from_bytes(raw[at + 2 : at + 4])
    return None


def _shaded(frame: Frame, stride: int, belt: BeltGeometry | None) -> NDArray[np.uint8]:
    """(h, w, 3) BGR of the depth: what is high is bright, lit from the upper left; black where there is no depth."""
    depth = np.ascontiguousarray(frame.depth[::stride, ::stride])
    depth_mm = depth.astype(np.float32) * np.float32(frame.depth_scale_m * 1000)
    height_mm = _height_mm(depth_mm, stride, belt)
    height_mm[depth == 0] = 0
    level = np.clip(height_mm * np.float32(255 / FULL_MM), 0, 255).astype(np.uint8)
    slope = np.zeros_like(height_mm)
    slope[1:, 1:] = height_mm[1:, 1:] - (height_mm[:-1, 1:] + height_mm[1:, :-1]) / 2
    light = np.clip(1 + slope / np.float32(SLOPE_MM), 0.45, 1.5)
    image = cv2.LUT(cv2.cvtColor(level, cv2.COLOR_GRAY2BGR), _palette())
    lit: NDArray[np.uint8] = np.clip(image * light[..., None], 0, 255).astype(np.uint8)
    lit[depth == 0] = 0
    return lit


def _height_mm(depth_mm: NDArray[np.float32], stride: int, belt: BeltGeometry | None) -> NDArray[np.float32]:
    if belt is None:
        known = depth_mm[depth_mm > 0]
        return np.float32(np.median(known) if known.size else 0) - depth_mm
    a, b, c, t = belt.height_coefficients()
    v, u = np.ogrid[: depth_mm.shape[0], : depth_mm.shape[1]]
    slope = (a * stride * u + b * stride * v + c).astype(np.float32)
    height: NDArray[np.float32] = np.asarray(depth_mm * slope + np.float32(1000 * t), np.float32)
    return height


@lru_cache(maxsize=1)
def _palette() -> NDArray[np.uint8]:
    """(256, 1, 3) BGR by height: belt, skin, the top of a tuber."""
    at = np.arange(256)
    channels = [np.interp(at, (0, 70, 255), ends) for ends in zip(BELT_BGR, SKIN_BGR, TOP_BGR, strict=True)]
    return np.stack(channels, axis=1).astype(np.uint8)[:, None, :]


def _outlines(
    frame: Frame, instances: Instances, found: Found, weights: ProvisionalWeights, stride: int
) -> tuple[Outline, ...]:
    tracks = {index: track for track, index in found}
    scale, shift = instances.stride / stride, (instances.stride - 1) / 2 / stride
    made = []
    for index in range(min(len(instances), MOST_OUTLINES)):
        top, bottom, left, right = instances.box[index].tolist()
        mask = (instances.labels[top : bottom + 1, left : right + 1] == index + 1).astype(np.uint8)
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=(left, top))
        if not contours:
            continue
        contour = max(contours, key=len)
        corners = cv2.approxPolyDP(contour, 0.8 / scale, True).reshape(-1, 2)
        corners = np.rint(corners[:: -(-len(corners) // MOST_CORNERS)] * scale + shift).astype(int)
        track = tracks.get(index)
        known = None if track is None else weights.of(track.track_id(frame.run, frame.camera))
        weight_g = None if known is None else known.weight_g
        made.append(Outline(tuple(corners.ravel().tolist()), _state(track, contour), weight_g))
    return tuple(made)


def _state(
    track: TrackState | None, contour: cv2.typing.MatLike
) -> Literal["seen", "counted", "lump", "haulm", "left_out"]:
    if track is None or track.state is State.OPEN:
        return "seen"
    if track.state is State.COUNTED:
        return "counted"
    if track.reason is TrackRefusal.DISTRACTOR or track.reason is TrackRefusal.THIN:
        sides = sorted(cv2.minAreaRect(contour)[1])
        return foreign_kind(track.reason, length_m=sides[1], width_m=max(sides[0], 1.0)) or "left_out"
    return "left_out"
