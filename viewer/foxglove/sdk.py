"""The only module that knows foxglove-sdk: primitives as messages of Foxglove's schemas, and its server."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.errors import ConfigError
from conveyor.extras import check_version, install_hint
from conveyor.geometry import Intrinsics, deproject
from viewer.scene.primitives import Box, Color, DepthPicture

INSTALL = f"install it {install_hint('foxglove')}"

try:
    import foxglove
    from foxglove import messages as schemas
    from foxglove.websocket import ServerListener
except ImportError as error:
    raise ConfigError(f"Foxglove needs foxglove-sdk, which cannot be imported ({error}); {INSTALL}") from error
check_version("foxglove-sdk", "0.30.", extra="foxglove", what="Foxglove")

__all__ = ["INSTALL", "ServerListener", "foxglove", "schemas"]

BELT, RIDING = "belt", "riding"
"""Frames of the scene: the belt's own, and what moves with it."""
MOST_CLOUD_POINTS = 20_000
LABEL_ABOVE_M = 0.012
LABEL_SIZE_M = 0.016
CLEAR, DIM = 0.35, 1.0


def camera_frame(camera: str) -> str:
    """Frame of a camera: x right, y down, z along the optical axis."""
    return f"camera/{camera}"


def stamp(captured_ns: int) -> Any:
    """Foxglove's time."""
    return schemas.Timestamp(sec=captured_ns // 1_000_000_000, nsec=captured_ns % 1_000_000_000)


def calibration(intrinsics: Intrinsics, frame: str, captured_ns: int) -> Any:
    """A pinhole without distortion."""
    k = intrinsics
    return schemas.CameraCalibration(
        timestamp=stamp(captured_ns),
        frame_id=frame,
        width=k.width,
        height=k.height,
        K=[k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[k.fx, 0.0, k.cx, 0.0, 0.0, k.fy, k.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def pose_transform(belt_from_camera: NDArray[np.float64], frame: str, captured_ns: int) -> Any:
    """Where a camera is over the belt."""
    x, y, z = (float(v) for v in belt_from_camera[:3, 3])
    return schemas.FrameTransform(
        timestamp=stamp(captured_ns),
        parent_frame_id=BELT,
        child_frame_id=frame,
        translation=schemas.Vector3(x=x, y=y, z=z),
        rotation=_quaternion(belt_from_camera[:3, :3]),
    )


def travel_transform(x_m: float, captured_ns: int) -> Any:
    """How far the belt has moved."""
    return schemas.FrameTransform(
        timestamp=stamp(captured_ns),
        parent_frame_id=BELT,
        child_frame_id=RIDING,
        translation=schemas.Vector3(x=x_m, y=0.0, z=0.0),
        rotation=schemas.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
    )


def depth_image(picture: DepthPicture, frame: str, captured_ns: int) -> Any:
    """The depth as it is, 16 bits; units are the camera's depth scale. A file compresses it, lossless."""
    height, width = picture.depth.shape
    return schemas.RawImage(
        timestamp=stamp(captured_ns),
        frame_id=frame,
        width=width,
        height=height,
        encoding="16UC1",
        step=2 * width,
        data=np.ascontiguousarray(picture.depth, "<u2").tobytes(),
    )


def color_image(jpeg: bytes, frame: str, captured_ns: int) -> Any:
    """The camera's JPEG."""
    return schemas.CompressedImage(timestamp=stamp(captured_ns), frame_id=frame, data=jpeg, format="jpeg")


def depth_cloud(picture: DepthPicture, intrinsics: Intrinsics, frame: str, captured_ns: int) -> Any:
    """Points of a depth picture in its camera's frame: every n-th pixel of every n-th row, `MOST_CLOUD_POINTS` at
    most."""
    every = max(1, math.ceil(math.sqrt(picture.depth.size / MOST_CLOUD_POINTS)))
    thinned = np.zeros_like(picture.depth)
    thinned[::every, ::every] = picture.depth[::every, ::every]
    points = deproject(thinned, depth_scale_m=picture.depth_scale_m, intrinsics=intrinsics)
    number = schemas.PackedElementFieldNumericType.Float32
    return schemas.PointCloud(
        timestamp=stamp(captured_ns),
        frame_id=frame,
        pose=_pose((0.0, 0.0, 0.0), 0.0),
        point_stride=12,
        fields=[schemas.PackedElementField(name=axis, offset=4 * n, type=number) for n, axis in enumerate("xyz")],
        data=np.ascontiguousarray(points, "<f4").tobytes(),
    )


def box_entity(box: Box, name: str, frame: str, captured_ns: int, values: dict[str, float]) -> Any:
    """A box with its label above it; `values` go along for machines."""
    texts = []
    if box.label:
        x, y, z = box.center_m
        label_pose = _pose((x, y, z + box.half_size_m[2] + LABEL_ABOVE_M), 0.0)
        texts = [_label(box.label, label_pose)]
    cube = schemas.CubePrimitive(
        pose=_pose(box.center_m, box.yaw_rad),
        size=schemas.Vector3(x=2 * box.half_size_m[0], y=2 * box.half_size_m[1], z=2 * box.half_size_m[2]),
        color=_color(box.color, DIM if box.solid else CLEAR),
    )
    return schemas.SceneEntity(
        timestamp=stamp(captured_ns),
        frame_id=frame,
        id=name,
        frame_locked=True,
        metadata=[schemas.KeyValuePair(key=key, value=f"{value:.6g}") for key, value in values.items()],
        cubes=[cube],
        texts=texts,
    )


def text_entity(text: str, name: str, at_m: tuple[float, float, float], captured_ns: int) -> Any:
    """Words that stand beside the belt."""
    return schemas.SceneEntity(
        timestamp=stamp(captured_ns), frame_id=BELT, id=name, frame_locked=True, texts=[_label(text, _pose(at_m, 0.0))]
    )


def scene(entities: list[Any], gone: list[str], captured_ns: int) -> Any:
    """One update of the scene."""
    deletions = [
        schemas.SceneEntityDeletion(
            timestamp=stamp(captured_ns), type=schemas.SceneEntityDeletionType.MatchingId, id=name
        )
        for name in gone
    ]
    return schemas.SceneUpdate(deletions=deletions, entities=entities)


def log_line(text: str, name: str, level: str, captured_ns: int) -> Any:
    """A line of the log panel."""
    levels = {"INFO": schemas.LogLevel.Info, "WARN": schemas.LogLevel.Warning, "ERROR": schemas.LogLevel.Error}
    return schemas.Log(timestamp=stamp(captured_ns), level=levels[level], message=text, name=name, file="", line=0)


def _label(text: str, pose: Any) -> Any:
    white = schemas.Color(r=1.0, g=1.0, b=1.0, a=1.0)
    return schemas.TextPrimitive(
        pose=pose, billboard=True, font_size=LABEL_SIZE_M, scale_invariant=False, color=white, text=text
    )


def _color(color: Color, alpha: float) -> Any:
    red, green, blue = (channel / 255 for channel in color)
    return schemas.Color(r=red, g=green, b=blue, a=alpha)


def _pose(at_m: tuple[float, float, float], yaw_rad: float) -> Any:
    x, y, z = at_m
    turn = schemas.Quaternion(x=0.0, y=0.0, z=math.sin(yaw_rad / 2), w=math.cos(yaw_rad / 2))
    return schemas.Pose(position=schemas.Vector3(x=x, y=y, z=z), orientation=turn)


def _quaternion(rotation: NDArray[np.float64]) -> Any:
    from scipy.spatial.transform import Rotation

    x, y, z, w = (float(v) for v in Rotation.from_matrix(rotation).as_quat())
    return schemas.Quaternion(x=x, y=y, z=z, w=w)
