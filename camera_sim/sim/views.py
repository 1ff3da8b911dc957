"""Single views of single tubers, for training and evaluating regressors: only the crop around the tuber is rendered."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from camera_sim.sim.belt import Belt, belt_depth, draw_belt
from camera_sim.sim.meshes import Vertices, inverse_rigid, rotation_about
from camera_sim.sim.optics import BASELINE_M, D405_848, D405_1280, Optics
from camera_sim.sim.poses import free_rotation, rest_on_belt
from camera_sim.sim.presets import Preset, initial_rotation, preset_named
from camera_sim.sim.raster import Canvas, Window, canvas_over, draw
from camera_sim.sim.stereo import NoiseBank, measure
from camera_sim.sim.tubers import Tuber, draw_tuber
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera, transform_points

SEASON_DISTANCES_M = (0.345, 0.460, 0.465)
TUBERS_PER_SESSION = 25
MARGIN_PX = 14
MAX_CROP_PX = 460


@dataclass(frozen=True, slots=True)
class ViewPlan:
    """What a pack of views shall hold. `camera` 'mixed' is either D405 resolution, `preset` may be 'mixed'."""

    seed: int
    views_per_tuber: int
    preset: str
    optics: Optics | None = None
    distances_m: tuple[float, ...] = SEASON_DISTANCES_M
    distance_range_m: tuple[float, float] | None = None
    fine_unit_share: float = 0.0
    clipped_share: float = 0.03


@dataclass(frozen=True, slots=True)
class SimulatedView:
    """One tuber in one frame as a regressor gets it, with its truth.

    Attributes:
        depth: (h, w) uint16 in units of `depth_scale_m`, zero outside the mask; u0, v0 its place in the image.
        belt_distance_m: as the system believes it; the truth differs by the preset's error, of sd `belt_sd_m`.
    """

    depth: NDArray[np.uint16]
    u0: int
    v0: int
    depth_scale_m: float
    intrinsics: Intrinsics
    belt_distance_m: float
    belt_sd_m: float
    v_centre: float
    tuber_id: int
    tuber: Tuber


@dataclass(frozen=True, slots=True)
class _Setting:
    """The camera over the belt during one tuber's ride."""

    preset: Preset
    optics: Optics
    unit_m: float
    true_distance_m: float
    believed_distance_m: float
    belt: Belt
    bank: NoiseBank


class ViewSimulator:
    """Makes views tuber by tuber; tuber `i` is the same whatever was made before it."""

    def __init__(self, plan: ViewPlan) -> None:
        self._plan = plan
        rng = np.random.default_rng([plan.seed, 0])
        self._bank = NoiseBank(rng, height=MAX_CROP_PX, width=MAX_CROP_PX)
        self._belts = [draw_belt(rng, soil_m=soil, cleat_m=cleat) for soil, cleat in ((8e-4, 0.0), (2e-3, 0.007))]

    def views(self, tuber_id: int) -> Iterator[SimulatedView]:
        """The views of tuber `tuber_id`; views in which nothing is left of it are not made, so there may be fewer."""
        plan = self._plan
        rng = np.random.default_rng([plan.seed, 1, tuber_id])
        session = np.random.default_rng([plan.seed, 2, tuber_id // TUBERS_PER_SESSION])
        tuber = draw_tuber(rng)
        setting = self._setting(rng, float(session.standard_normal()))
        preset = setting.preset
        start = initial_rotation(tuber.vertices, preset, rng)
        roll_axis = rotation_about(np.array([0.0, 0.0, 1.0]), rng.uniform(0, 2 * np.pi))[:, 0]
        roll_rad = np.radians(preset.roll_sd_deg) * float(np.clip(rng.standard_normal(), -2, 2))
        lift_m = abs(preset.lift_sd_m * rng.standard_normal())
        across = rng.uniform(-0.8, 0.8)
        shares = np.sort(_ride(rng, plan.views_per_tuber))
        for share in shares:
            rotation = rotation_about(roll_axis, roll_rad * share) @ start
            body = rest_on_belt(tuber.vertices, rotation) + np.array([0.0, 0.0, lift_m])
            view = self._view(tuber, tuber_id, body, setting, share, across, rng)
            if view is not None:
                yield view

    def _setting(self, rng: Generator, session_error: float) -> _Setting:
        plan = self._plan
        preset = preset_named(plan.preset, rng)
        optics = plan.optics or (D405_1280 if rng.random() < 0.6 else D405_848)
        distance = float(rng.choice(np.asarray(plan.distances_m)))
        if plan.distance_range_m is not None and rng.random() < 0.4:
            distance = float(rng.uniform(*plan.distance_range_m))
        error = preset.belt_error_session_m * session_error + preset.belt_error_tuber_m * float(rng.standard_normal())
        unit_m = 1e-4 if rng.random() < plan.fine_unit_share else 1e-3
        belt = self._belts[int(rng.random() < 0.6)]
        return _Setting(preset, optics, unit_m, distance - error, distance, belt, self._bank)

    def _view(
        self,
        tuber: Tuber,
        tuber_id: int,
        body: Vertices,
        setting: _Setting,
        share: float,
        across: float,
        rng: Generator,
    ) -> SimulatedView | None:
        intrinsics = setting.optics.intrinsics
        belt_from_camera = straight_down_belt_from_camera(setting.true_distance_m)
        camera_from_belt = inverse_rigid(belt_from_camera)
        place = _place(body, setting, share, across, clipped=rng.random() < self._plan.clipped_share)
        points = transform_points(camera_from_belt, body + place)
        window = _window_around(points, intrinsics)
        if window is None:
            return None
        canvas = _background(setting, window, belt_from_camera, float(rng.uniform(0, 1)))
        draw(canvas, points, tuber.faces, intrinsics=intrinsics, instance=1)
        if rng.random() < setting.preset.touched:
            _draw_neighbour(canvas, body + place, camera_from_belt, intrinsics, rng)
        depth = measure(
            (1 / canvas.inverse_depth).astype(np.float32),
            focal_px=intrinsics.fx,
            unit_m=setting.unit_m,
            noise=setting.preset.noise,
            bank=setting.bank,
            rng=rng,
            left_border=window.u0 == 0,
        )
        floor_m = rng.uniform(0.004, 0.009) if rng.random() < 0.7 else -1.0
        mask = _ragged_mask(canvas.ids == 1, setting, rng)
        mask &= depth > 0
        mask &= depth < (setting.true_distance_m - floor_m) / setting.unit_m
        return _cropped(np.where(mask, depth, 0).astype(np.uint16), window, setting, tuber, tuber_id, points)


def _ride(rng: Generator, views: int) -> NDArray[np.float64]:
    """Where along its ride through the image the tuber is seen, -1 to 1; 31 and more are spread evenly."""
    return np.linspace(-1, 1, views) if views >= 31 else rng.uniform(-1, 1, views)


def _place(body: Vertices, setting: _Setting, share: float, across: float, *, clipped: bool) -> NDArray[np.float64]:
    """Where on the belt the tuber lies so that it is whole in the image at its row; or reaches over the border."""
    k = setting.optics.intrinsics
    top = float(body[:, 2].max())
    reach_z = setting.true_distance_m - top
    half_x = float(np.abs(body[:, 0]).max())
    half_y = float(np.abs(body[:, 1]).max())
    slack = -0.3 if clipped else 1.02
    ahead, behind = (k.height - 1 - k.cy) / k.fy * reach_z, k.cy / k.fy * reach_z
    right, left = (k.width - 1 - k.cx) / k.fx * reach_z, (k.cx - k.fx * BASELINE_M / reach_z) / k.fx * reach_z
    free_x = max(0.0, (ahead if share > 0 else behind) - slack * half_x)
    free_y = max(0.0, (right if across > 0 else left) - 1.02 * half_y)
    return np.array([share * free_x, across * free_y, 0.0])


def _window_around(points: Vertices, k: Intrinsics) -> Window | None:
    u = k.fx * points[:, 0] / points[:, 2] + k.cx
    v = k.fy * points[:, 1] / points[:, 2] + k.cy
    u0, v0 = max(0, int(u.min()) - MARGIN_PX), max(0, int(v.min()) - MARGIN_PX)
    u1, v1 = min(k.width, int(u.max()) + MARGIN_PX + 1), min(k.height, int(v.max()) + MARGIN_PX + 1)
    height, width = min(v1 - v0, MAX_CROP_PX), min(u1 - u0, MAX_CROP_PX)
    return Window(u0, v0, height, width) if height > 8 and width > 8 else None


def _background(setting: _Setting, window: Window, belt_from_camera: NDArray[np.float64], travel_m: float) -> Canvas:
    depth = belt_depth(
        setting.belt,
        intrinsics=setting.optics.intrinsics,
        belt_from_camera=belt_from_camera,
        travel_m=travel_m,
        u0=window.u0,
        v0=window.v0,
        height=window.height,
        width=window.width,
    )
    return canvas_over(depth, window)


def _draw_neighbour(
    canvas: Canvas, body: Vertices, camera_from_belt: NDArray[np.float64], k: Intrinsics, rng: Generator
) -> None:
    """Another tuber that touches `body`: as near as two bodies parted by an upright plane can be."""
    other = draw_tuber(rng, level=3)
    turned = rest_on_belt(other.vertices, free_rotation(rng))
    heading = rng.uniform(0, 2 * np.pi)
    towards = np.array([np.cos(heading), np.sin(heading)])
    distance = float((body[:, :2] @ towards).max() - (turned[:, :2] @ towards).min())
    middle = (body[:, :2].max(axis=0) + body[:, :2].min(axis=0)) / 2
    centre = towards * (distance - float(middle @ towards)) + middle
    shifted = turned + np.array([centre[0], centre[1], 0.0])
    draw(canvas, transform_points(camera_from_belt, shifted), other.faces, intrinsics=k, instance=2)


def _ragged_mask(mask: NDArray[np.bool_], setting: _Setting, rng: Generator) -> NDArray[np.bool_]:
    """The mask as a segmenter gives it: its edge wanders, and it is a little too large or too small."""
    height, width = mask.shape
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    ragged = np.float32(setting.preset.ragged_px)
    du = columns + ragged * setting.bank.take(setting.bank.edge, rng, height, width)
    dv = rows + ragged * setting.bank.take(setting.bank.edge, rng, height, width)
    out = cv2.remap(mask.astype(np.uint8), du, dv, cv2.INTER_NEAREST)
    change = int(rng.choice(np.array([-2, -1, 0, 0, 0, 1])))
    if change:
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * abs(change) + 1,) * 2)
        out = cv2.erode(out, kernel) if change < 0 else cv2.dilate(out, kernel)
    return _largest_part(np.asarray(out, np.uint8))


def _largest_part(mask: NDArray[np.uint8]) -> NDArray[np.bool_]:
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    if count < 2:
        return np.asarray(mask > 0)
    return np.asarray(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))


def _cropped(
    depth: NDArray[np.uint16], window: Window, setting: _Setting, tuber: Tuber, tuber_id: int, points: Vertices
) -> SimulatedView | None:
    rows, columns = np.nonzero(depth.any(axis=1))[0], np.nonzero(depth.any(axis=0))[0]
    if np.count_nonzero(depth) < 150:
        return None
    v0, u0 = int(rows[0]), int(columns[0])
    k = setting.optics.intrinsics
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return SimulatedView(
        depth=np.ascontiguousarray(depth[v0 : rows[-1] + 1, u0 : columns[-1] + 1]),
        u0=window.u0 + u0,
        v0=window.v0 + v0,
        depth_scale_m=setting.unit_m,
        intrinsics=k,
        belt_distance_m=setting.believed_distance_m,
        belt_sd_m=setting.preset.belt_sd_m,
        v_centre=float(k.fy * middle[1] / middle[2] + k.cy),
        tuber_id=tuber_id,
        tuber=tuber,
    )
