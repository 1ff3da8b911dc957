"""Shapes of the picture: what a camera sees of the belt, the box of a tuber, intrinsics of a strided picture."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from conveyor.geometry import Intrinsics, straight_down_belt_from_camera, transform_points
from conveyor.messages import Frame, Tuber
from viewer.scene.primitives import Box, Color


def footprint_m(intrinsics: Intrinsics, belt_from_camera: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """(x0, x1, y0, y1) of the belt seen by a camera, belt frame, metres: the image's corners projected onto z = 0."""
    corners = [(u, v) for u in (0, intrinsics.width - 1) for v in (0, intrinsics.height - 1)]
    rays = np.array(
        [((u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy, 1.0) for u, v in corners]
    )
    directions = rays @ belt_from_camera[:3, :3].T
    reach = belt_from_camera[2, 3] / np.maximum(-directions[:, 2], 1e-3)
    ground = transform_points(belt_from_camera, rays * reach[:, None])
    x, y = ground[:, 0], ground[:, 1]
    return float(x.min()), float(x.max()), float(y.min()), float(y.max())


def weight_color(weight_g: float) -> Color:
    """Small tubers blue, medium ones green, big ones orange."""
    stops = np.array([[90, 160, 255], [110, 220, 110], [255, 190, 60], [255, 110, 60]], float)
    at = np.clip((weight_g - 50.0) / 100.0, 0.0, 3.0)
    red, green, blue = (int(np.interp(at, range(4), stops[:, channel])) for channel in range(3))
    return red, green, blue


def yaw_rad(points_in_belt_m: NDArray[np.float64]) -> float:
    """Heading of the longest horizontal axis of an (N, 3) cloud, from x towards y."""
    x, y = (points_in_belt_m[:, :2] - points_in_belt_m[:, :2].mean(axis=0)).T
    return 0.5 * math.atan2(2 * float(x @ y), float(x @ x) - float(y @ y))


def tuber_box(tuber: Tuber, yaw: float | None) -> Box:
    """The tuber at its place with its weight; '~' marks a weight by volume alone."""
    length, width, height = tuber.length_mm / 1000, tuber.width_mm / 1000, tuber.height_mm / 1000
    if yaw is None:  # its heading was not seen: a square box that holds it either way on the average
        length = width = (length + width) / 2
    about = "~" if tuber.method == "volume" else ""
    return Box(
        (tuber.place_x_m, tuber.place_y_m, height / 2),
        (length / 2, width / 2, height / 2),
        weight_color(tuber.weight_g),
        label=f"{about}{tuber.weight_g:.0f} g",
        yaw_rad=yaw or 0.0,
        values=(
            ("tuber_id", float(tuber.tuber_id)),
            ("weight_g", tuber.weight_g),
            ("low_g", tuber.low_g),
            ("high_g", tuber.high_g),
        ),
    )


def camera_pose(frame: Frame) -> NDArray[np.float64] | None:
    """(4, 4) belt_from_camera of a frame; None for a camera that is not calibrated."""
    if frame.belt_from_camera is not None:
        return frame.belt_from_camera
    return None if frame.belt_distance_m is None else straight_down_belt_from_camera(frame.belt_distance_m)


def strided(intrinsics: Intrinsics, stride: int) -> Intrinsics:
    """Intrinsics of `depth[::stride, ::stride]`: pixel (u, v) of it is pixel (u * stride, v * stride) of the whole."""
    return replace(
        intrinsics,
        width=-(-intrinsics.width // stride),
        height=-(-intrinsics.height // stride),
        fx=intrinsics.fx / stride,
        fy=intrinsics.fy / stride,
        cx=intrinsics.cx / stride,
        cy=intrinsics.cy / stride,
    )
