"""Cameras of the other world: exact depth by a z-buffer of our own, and what several kinds of sensor make of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import cv2
import numba
import numpy as np

MASK_BELT = 0
Bodies = Sequence[tuple[np.ndarray, np.ndarray]]
"""Meshes in belt coordinates: vertices (N, 3) in metres and triangles (M, 3)."""


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera above the belt. It stands at (x_m, y_m) in belt coordinates, `height_m` above the belt, and looks down,
    pitched (about its u axis) and rolled (about its v axis) by some degrees."""

    name: str
    width: int
    height: int
    focal_px: float
    height_m: float
    x_m: float = 0.0
    y_m: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    late_s: float = 0.0

    @property
    def centre_px(self) -> tuple[float, float]:
        return self.width / 2 + 1.7, self.height / 2 - 2.3

    @property
    def straight(self) -> bool:
        return not (self.x_m or self.y_m or self.pitch_deg or self.roll_deg)

    @property
    def belt_from_camera(self) -> np.ndarray:
        """4x4: belt x along the image's +v, y along +u, z up."""
        a, b = np.deg2rad([self.pitch_deg, self.roll_deg])
        pitch = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        roll = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
        down = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
        pose = np.eye(4)
        pose[:3, :3] = down @ pitch @ roll
        pose[:3, 3] = self.x_m, self.y_m, self.height_m
        return pose

    @property
    def belt_distance_m(self) -> float:
        """Camera to belt along the optical axis."""
        return self.height_m / -float(self.belt_from_camera[2, 2])

    def in_camera(self, points_m: np.ndarray) -> np.ndarray:
        """Points (N, 3) of belt coordinates in the camera's frame."""
        pose = self.belt_from_camera
        return np.asarray((points_m - pose[:3, 3]) @ pose[:3, :3])

    def belt_depth_m(self) -> np.ndarray:
        """Depth (H, W) of the bare belt."""
        return bare_m(self.height, self.width, self.belt_from_camera, self.focal_px, *self.centre_px)


def bare_m(height: int, width: int, pose: np.ndarray, focal: float, cx: float, cy: float) -> np.ndarray:
    """Depth (height, width) of the bare belt along the axis of a camera at `pose` (4x4, belt from camera)."""
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    up = pose[2, :3]
    slope = up[0] * (u - cx) / focal + up[1] * (v - cy) / focal + up[2]
    return np.asarray(-pose[2, 3] / slope)


@numba.njit(cache=True)
def draw(depth_m, label, points, triangles, number, focal, cx, cy):  # type: ignore[no-untyped-def]
    """Draw a mesh (camera frame, metres) into depth and label where it is nearer than what stands there."""
    height, width = depth_m.shape
    count = points.shape[0]
    u, v, w = np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        w[i] = 1.0 / points[i, 2]
        u[i] = points[i, 0] * w[i] * focal + cx
        v[i] = points[i, 1] * w[i] * focal + cy
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t]
        area = (u[b] - u[a]) * (v[c] - v[a]) - (u[c] - u[a]) * (v[b] - v[a])
        if abs(area) < 1e-12:
            continue
        first, last = int(np.ceil(min(v[a], v[b], v[c]))), int(np.floor(max(v[a], v[b], v[c])))
        left, right = int(np.ceil(min(u[a], u[b], u[c]))), int(np.floor(max(u[a], u[b], u[c])))
        for row in range(max(first, 0), min(last, height - 1) + 1):
            for column in range(max(left, 0), min(right, width - 1) + 1):
                kb = ((column - u[a]) * (v[c] - v[a]) - (u[c] - u[a]) * (row - v[a])) / area
                kc = ((u[b] - u[a]) * (row - v[a]) - (column - u[a]) * (v[b] - v[a])) / area
                if kb < 0 or kc < 0 or kb + kc > 1:
                    continue
                z = 1.0 / (w[a] * (1 - kb - kc) + w[b] * kb + w[c] * kc)
                if z < depth_m[row, column]:
                    depth_m[row, column] = z
                    label[row, column] = number


def draw_bodies(
    depth_m: np.ndarray, bodies: Bodies, pose: np.ndarray, focal: float, cx: float, cy: float
) -> np.ndarray:
    """Draw bodies into `depth_m` as a camera at `pose` (4x4, belt from camera) sees them; labels, numbered from 1."""
    label = np.zeros(depth_m.shape, np.uint16)
    for number, (points, triangles) in enumerate(bodies, 1):
        seen = np.asarray((points - pose[:3, 3]) @ pose[:3, :3])
        if seen[:, 2].min() > 0.02:
            draw(depth_m, label, seen, triangles, number, focal, cx, cy)
    return label


@dataclass(frozen=True, slots=True)
class Sensor:
    """What a sensor makes of exact depth. Zero means: it does not do that."""

    unit_m: float = 0.001
    baseline_m: float = 0.0  # 0: no stereo, only `axial_mm`
    axial_mm: float = 0.0  # white noise along the ray (time of flight)
    mix_px: int = 0  # window that averages depth over outlines (flying pixels)
    noise_px: float = 0.0  # disparity noise after the window
    window_px: float = 1.5  # sigma over which disparity noise is smoothed
    step_px: float = 0.0  # disparity is rounded to this
    fatten_px: int = 0  # foreground grows by this over the background at outlines
    steep_px: float = 0.0  # no depth where disparity changes by more than this a pixel
    outline_px: int = 0  # ragged band without depth around outlines
    shadow: bool = False  # no depth where the second imager cannot see
    islands: float = 0.0  # mismatched islands a frame (mean)
    speckle: float = 0.0  # share of the belt without depth, in specks
    bow_px: float = 0.0  # slow error over the image, the same in all frames
    filled: bool = False  # holes are filled with the farthest depth around, as camera software offers

    def view(self, camera: Camera, rng: np.random.Generator) -> View:
        """Before a camera; `rng` draws what it does wrong."""
        return View(camera, self, rng)


@numba.njit(cache=True)
def unseen(disparity):  # type: ignore[no-untyped-def]
    """Which pixels of the left image the right imager cannot see: something nearer stands in its row before them."""
    height, width = disparity.shape
    hidden = np.zeros((height, width), np.bool_)
    for row in range(height):
        nearest = 1e9
        for column in range(width - 1, -1, -1):
            place = column - disparity[row, column]
            if place >= nearest - 0.25 and nearest < 1e9:
                hidden[row, column] = place >= nearest + 0.75
            nearest = min(nearest, place)
    return hidden


class View:
    """A camera with its sensor: exact frames, and measured ones in whole units."""

    def __init__(self, camera: Camera, sensor: Sensor, rng: np.random.Generator) -> None:
        self.camera, self.sensor, self.rng = camera, sensor, rng
        self._belt_m = camera.belt_depth_m()
        shape = (camera.height, camera.width)
        self._bow = cv2.resize(rng.normal(size=(4, 5)), shape[::-1], interpolation=cv2.INTER_CUBIC) * sensor.bow_px
        self._texture = self._smooth(rng.normal(size=shape), 3.0)

    def exact(self, bodies: Bodies) -> tuple[np.ndarray, np.ndarray]:
        """Depth m (H, W) and label uint16 of meshes in belt coordinates, numbered from 1."""
        camera, depth_m = self.camera, self._belt_m.copy()
        label = draw_bodies(depth_m, bodies, camera.belt_from_camera, camera.focal_px, *camera.centre_px)
        return depth_m, label

    def measured(
        self, depth_m: np.ndarray, label: np.ndarray, bodies: Bodies = (), travel_m: float = 0.0
    ) -> np.ndarray:
        """uint16 (H, W) in `unit_m`, 0 = no depth.

        Args:
            depth_m, label: as `exact` gives them. bodies, travel_m: as it takes them, and how far the belt has come;
                for sensors that look at them themselves.
        """
        sensor, rng = self.sensor, self.rng
        if sensor.mix_px:
            depth_m = cv2.blur(depth_m, (sensor.mix_px, sensor.mix_px))
        if sensor.axial_mm:
            depth_m = depth_m + rng.normal(size=depth_m.shape) * sensor.axial_mm / 1000
        lost = np.zeros(depth_m.shape, bool)
        if sensor.baseline_m:
            depth_m, lost = self._stereo(depth_m)
        if sensor.speckle:
            specks = self._smooth(rng.normal(size=depth_m.shape), 1.2) > NormalDist().inv_cdf(1 - sensor.speckle)
            lost |= specks & (label == MASK_BELT)
        units = np.clip(np.rint(depth_m / sensor.unit_m), 0, 65535)
        units[lost] = 0
        if sensor.filled:
            units = _fill(units)
        return np.asarray(units, np.uint16)

    def _stereo(self, depth_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sensor, rng = self.sensor, self.rng
        scale = self.camera.focal_px * sensor.baseline_m
        disparity = scale / depth_m
        lost = unseen(disparity) if sensor.shadow else np.zeros(depth_m.shape, bool)
        slope = np.maximum(np.abs(cv2.Scharr(disparity, -1, 1, 0)), np.abs(cv2.Scharr(disparity, -1, 0, 1))) / 32
        if sensor.steep_px:
            lost |= slope * (1 + 0.3 * self._texture) > sensor.steep_px
        if sensor.outline_px:
            edge = (slope > 0.8).astype(np.uint8)
            ragged = self._smooth(rng.normal(size=depth_m.shape), 2.0)
            far = cv2.distanceTransform(1 - edge, cv2.DIST_L2, 3)
            lost |= far < sensor.outline_px * np.clip(0.6 + 0.5 * ragged, 0, 2)
        if sensor.fatten_px:
            disparity = _fattened(disparity, sensor.fatten_px)
        noise = self._smooth(rng.normal(size=depth_m.shape), sensor.window_px) * 0.9
        disparity = disparity + sensor.noise_px * (noise + 0.3 * rng.normal(size=depth_m.shape)) + self._bow
        for _ in range(rng.poisson(sensor.islands)):
            v, u = rng.integers(depth_m.shape[0]), rng.integers(depth_m.shape[1])
            axes = (int(rng.integers(2, 9)), int(rng.integers(2, 9)))
            island = cv2.ellipse(np.zeros(depth_m.shape, np.uint8), (int(u), int(v)), axes, 0, 0, 360, 1, -1)
            disparity[island > 0] += rng.choice([-1, 1]) * rng.uniform(0.15, 0.6) * disparity[v, u]
        if sensor.step_px:
            disparity = np.rint(disparity / sensor.step_px) * sensor.step_px
        lost |= disparity <= 0.5
        lost[:, : int(disparity.mean())] |= sensor.shadow  # the second imager does not see this far to the left
        return scale / np.maximum(disparity, 0.5), lost

    @staticmethod
    def _smooth(field: np.ndarray, sigma: float) -> np.ndarray:
        """White noise smoothed, with sd 1 again."""
        smooth = cv2.GaussianBlur(field, (0, 0), sigma)
        return np.asarray(smooth / smooth.std())


def _fattened(disparity: np.ndarray, reach_px: int) -> np.ndarray:
    """The nearer side of each step in disparity grows over the farther one, as a matching window makes it grow. What
    slopes without a step stays: a window that always took the nearest would blow bodies up.
    """
    size = np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)
    near, far = cv2.dilate(disparity, np.ones((3, 3))), cv2.erode(disparity, np.ones((3, 3)))
    step = cv2.dilate((near - far > 1.0).astype(np.uint8), size) > 0
    around, below = cv2.dilate(disparity, size), cv2.erode(disparity, size)
    return np.where(step & (disparity < (around + below) / 2), around, disparity)


def _fill(units: np.ndarray) -> np.ndarray:
    """Holes of up to 24 px take the farthest valid depth around them."""
    filled = units.copy()
    for _ in range(12):
        hole = filled == 0
        if not hole.any():
            break
        filled[hole] = cv2.dilate(filled, np.ones((3, 3), np.uint8))[hole]
    return filled
