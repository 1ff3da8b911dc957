"""Tiny analytic scenes with truth: ellipsoids on a plane, seen by a pinhole camera. Not a simulator: a ruler."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import Frame
from segmenter.results import ClosedTrack

SMALL = Intrinsics(424, 240, 216.5, 216.5, 212.0, 120.0)
MEDIUM = Intrinsics(848, 480, 433.0, 433.0, 424.0, 240.0)


@dataclass(frozen=True, slots=True)
class Body:
    """An ellipsoid lying on the belt at a place; half axes along, across (turned by `yaw`) and up, metres."""

    place_x_m: float
    y_m: float
    a_m: float = 0.040
    b_m: float = 0.032
    c_m: float = 0.027
    yaw: float = 0.0

    @property
    def volume_under_m3(self) -> float:
        """Volume under the visible side down to the belt, seen from far above."""
        return float(np.pi * self.a_m * self.b_m * self.c_m * (1 + 2 / 3))


@dataclass(slots=True)
class Scene:
    """Bodies, a camera and the noise it adds."""

    bodies: list[Body]
    intrinsics: Intrinsics = SMALL
    belt_from_camera: NDArray[np.float64] = field(default_factory=lambda: straight_down_belt_from_camera(0.46))
    scale_m: float = 0.001
    noise_m: float = 0.0
    holes: float = 0.0
    seed: int = 0
    _x: NDArray[np.float64] = field(init=False)
    _y: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        k = self.intrinsics
        self._x, self._y = (np.arange(k.width) - k.cx) / k.fx, (np.arange(k.height)[:, None] - k.cy) / k.fy

    def render(self, travel_m: float, index: int = 0) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
        """((H, W) uint16 depth in units of `scale_m`, (H, W) uint16 labels: body number + 1) at a belt travel."""
        belt_from_camera, origin = self.belt_from_camera[:3, :3], self.belt_from_camera[:3, 3]
        right, down, ahead = belt_from_camera[2]
        z = -origin[2] / (right * self._x + down * self._y + ahead)
        labels = np.zeros(z.shape, np.uint16)
        for number, body in enumerate(self.bodies, start=1):
            centre = np.array([body.place_x_m + travel_m, body.y_m, body.c_m])
            if abs(centre[0] - origin[0]) > 0.8:
                continue
            near = _box(self, centre, body)
            if near is None:
                continue
            turn = np.array(
                [[np.cos(body.yaw), np.sin(body.yaw), 0], [-np.sin(body.yaw), np.cos(body.yaw), 0], [0, 0, 1]]
            ) / np.array([[body.a_m], [body.b_m], [body.c_m]])
            # A ray is x * right + y * down + ahead, here where the body is a ball of radius 1: its depth is the near
            # root of qa z^2 + 2 qb z + qc, whose products are those of three vectors and not of each pixel's.
            axes, o = turn @ belt_from_camera, turn @ (origin - centre)
            (xx, xy, xz), (_, yy, yz), (_, _, zz) = axes.T @ axes
            x, y = self._x[near[1]], self._y[near[0]]
            qa = (xx * x + 2 * xz) * x + ((yy * y + 2 * yz) * y + zz) + (2 * xy * y) * x
            right, down, ahead = o @ axes
            qb = right * x + (down * y + ahead)
            root = qb * qb - qa * (o @ o - 1)
            depth = (-qb - np.sqrt(np.maximum(root, 0))) / qa
            closer = (root > 0) & (depth < z[near])
            np.copyto(z[near], depth, where=closer)
            labels[near][closer] = number
        rng = np.random.default_rng([self.seed, index])
        if self.noise_m:
            z = z + rng.normal(0, self.noise_m, z.shape)
        depth_units = np.round(z / self.scale_m).astype(np.uint16)
        if self.holes:
            depth_units[rng.random(z.shape) < self.holes] = 0
        return depth_units, labels

    def frame(
        self, seq: int, travel_m: float, *, fps: float = 30.0, encoder: bool = True, calibrated: bool = True
    ) -> Frame:
        """The message a camera would send."""
        depth, _ = self.render(travel_m, seq)
        return Frame(
            camera="front",
            run="r1",
            seq=seq,
            captured_ns=round(seq * 1e9 / fps),
            travel_m=travel_m if encoder else None,
            depth_scale_m=self.scale_m,
            intrinsics=self.intrinsics,
            belt_distance_m=None,
            depth=depth,
            belt_from_camera=self.belt_from_camera if calibrated else None,
        )


def tilted(distance_m: float, tilt_deg: float, roll_deg: float = 0.0) -> NDArray[np.float64]:
    """belt_from_camera of a camera tilted about the image's u axis (and rolled about v), axis meeting the origin."""
    s, c = np.sin(np.radians(tilt_deg)), np.cos(np.radians(tilt_deg))
    s2, c2 = np.sin(np.radians(roll_deg)), np.cos(np.radians(roll_deg))
    about_u = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    about_v = np.array([[c2, 0, s2], [0, 1, 0], [-s2, 0, c2]])
    pose = straight_down_belt_from_camera(distance_m)
    pose[:3, :3] = pose[:3, :3] @ about_u @ about_v
    pose[:3, 3] = -pose[:3, :3] @ np.array([0, 0, distance_m])
    return pose


def scattered(count: int, *, seed: int, spacing_m: float = 0.12, half_width_m: float = 0.12) -> list[Body]:
    """Tubers of many sizes behind one another, each within a cell of its own; places fall from 0 backwards."""
    rng = np.random.default_rng(seed)
    lanes = np.array([-half_width_m, 0.0, half_width_m])
    bodies = []
    for index in range(count):
        a, b, c = np.sort(rng.uniform(0.020, 0.045, 3))[::-1]
        row, lane = divmod(index, 3)
        bodies.append(
            Body(
                place_x_m=-row * spacing_m - 0.05 + float(rng.uniform(-0.01, 0.01)),
                y_m=float(lanes[lane] + rng.uniform(-0.01, 0.01)),
                a_m=float(a),
                b_m=float(b),
                c_m=float(c),
                yaw=float(rng.uniform(0, np.pi)),
            )
        )
    return bodies


def worn(frame: Frame, body: NDArray[np.uint8], px: float) -> Frame:
    """The frame with its tubers' outlines moved out by `px` pixels, or in where it is below 0."""
    depth = frame.depth
    if px > 0:
        away, nearest = cv2.distanceTransformWithLabels(1 - body, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
        of = np.zeros(int(nearest.max()) + 1, np.uint16)
        of[nearest[body > 0]] = depth[body > 0]
        depth = np.where((body == 0) & (away <= px), of[nearest], depth)
    else:
        inside = cv2.distanceTransform(body, cv2.DIST_L2, 5)
        depth = np.where((body > 0) & (inside <= -px), 0, depth)
    return replace(frame, depth=depth.astype(np.uint16))


def seen_px(closed: Iterable[ClosedTrack]) -> dict[float, int]:
    """By place, the pixels of each tuber's best view."""
    return {round(c.track.place_x_m, 2): int(np.count_nonzero(c.views[0].depth)) for c in closed}


def _box(scene: Scene, centre: NDArray[np.float64], body: Body) -> tuple[slice, slice] | None:
    """Image region that can hold a body."""
    k, m = scene.intrinsics, scene.belt_from_camera
    p = m[:3, :3].T @ (centre - m[:3, 3])
    if p[2] <= 0.05:
        return None
    radius = max(body.a_m, body.b_m, body.c_m) * max(k.fx, k.fy) / (p[2] - 0.05) * 1.6
    u, v = k.cx + k.fx * p[0] / p[2], k.cy + k.fy * p[1] / p[2]
    rows = slice(max(0, int(v - radius)), max(0, min(k.height, int(v + radius) + 1)))
    columns = slice(max(0, int(u - radius)), max(0, min(k.width, int(u + radius) + 1)))
    return (rows, columns) if rows.stop > rows.start and columns.stop > columns.start else None
