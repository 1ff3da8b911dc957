"""A z-buffer for triangle meshes seen by a pinhole camera: depth and instance id per pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conveyor.geometry import Intrinsics
from conveyor.kernels import kernel


@dataclass(frozen=True, slots=True)
class Window:
    """A part of the image: its first column and row, its size."""

    u0: int
    v0: int
    height: int
    width: int


def whole_image(intrinsics: Intrinsics) -> Window:
    """The window that is the image."""
    return Window(0, 0, intrinsics.height, intrinsics.width)


@dataclass(frozen=True, slots=True)
class Canvas:
    """What was drawn so far: 1/z per metre and the id of what is seen there, 0 = background.

    `inverse_depth` (h, w) float32; `ids` (h, w) int32.
    """

    window: Window
    inverse_depth: NDArray[np.float32]
    ids: NDArray[np.int32]


def canvas_over(depth_m: NDArray[np.float32], window: Window) -> Canvas:
    """A canvas with a background at `depth_m` (h, w), metres."""
    return Canvas(window, (1.0 / depth_m).astype(np.float32), np.zeros(depth_m.shape, np.int32))


def draw(
    canvas: Canvas,
    points_in_camera: NDArray[np.float64],
    faces: NDArray[np.int32],
    *,
    intrinsics: Intrinsics,
    instance: int,
) -> None:
    """Draw a mesh into `canvas`, nearer surfaces win.

    Args:
        points_in_camera: (V, 3) metres; the mesh must lie in front of the camera.
        faces: (F, 3) outward; those that look away are skipped.
        instance: id to write where the mesh is nearest.
    """
    z = points_in_camera[:, 2]
    if z.min() <= 0.01:
        return
    w = canvas.window
    u = intrinsics.fx * points_in_camera[:, 0] / z + (intrinsics.cx - w.u0)
    v = intrinsics.fy * points_in_camera[:, 1] / z + (intrinsics.cy - w.v0)
    if u.max() < 0 or v.max() < 0 or u.min() > w.width - 1 or v.min() > w.height - 1:
        return
    _fill(canvas.inverse_depth, canvas.ids, u, v, 1.0 / z, faces, instance)


def fill_highest(
    height_m: NDArray[np.float32],
    ids: NDArray[np.int32],
    columns: NDArray[np.float64],
    rows: NDArray[np.float64],
    z_m: NDArray[np.float64],
    faces: NDArray[np.int32],
) -> None:
    """Draw a mesh seen from straight above and infinitely far into a map (h, w) of heights; higher surfaces win.

    `columns`, `rows` (V,): where its vertices lie in the map, columns along belt y, rows along belt x.
    """
    _fill(height_m, ids, columns, rows, z_m, faces, 1)


@kernel(nogil=True)
def _fill(
    inverse_depth: NDArray[np.float32],
    ids: NDArray[np.int32],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    w: NDArray[np.float64],
    faces: NDArray[np.int32],
    instance: int,
) -> None:
    """Scan-convert all front faces; 1/z is linear in the image, so the interpolation is exact."""
    height, width = inverse_depth.shape
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        area = (u[b] - u[a]) * (v[c] - v[a]) - (u[c] - u[a]) * (v[b] - v[a])
        if area >= 0:  # outward faces towards the camera turn clockwise in image coordinates (v down, z forward)
            continue
        low_v = max(0, int(np.ceil(min(v[a], v[b], v[c]))))
        high_v = min(height - 1, int(np.floor(max(v[a], v[b], v[c]))))
        low_u = max(0, int(np.ceil(min(u[a], u[b], u[c]))))
        high_u = min(width - 1, int(np.floor(max(u[a], u[b], u[c]))))
        if low_v > high_v or low_u > high_u:
            continue
        scale = 1.0 / area
        step_b = (v[c] - v[a]) * scale
        step_c = -(v[b] - v[a]) * scale
        slope = step_b * (w[b] - w[a]) + step_c * (w[c] - w[a])
        for y in range(low_v, high_v + 1):
            du, dv = low_u - u[a], y - v[a]
            share_b = (du * (v[c] - v[a]) - dv * (u[c] - u[a])) * scale
            share_c = (dv * (u[b] - u[a]) - du * (v[b] - v[a])) * scale
            value = w[a] + share_b * (w[b] - w[a]) + share_c * (w[c] - w[a])
            for x in range(low_u, high_u + 1):
                inside = share_b >= -1e-9 and share_c >= -1e-9 and share_b + share_c <= 1 + 1e-9
                if inside and value > inverse_depth[y, x]:
                    inverse_depth[y, x] = value
                    ids[y, x] = instance
                share_b += step_b
                share_c += step_c
                value += slope
