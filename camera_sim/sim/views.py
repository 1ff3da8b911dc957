"""Single views of single tubers, for training and evaluating regressors: only the crop around the tuber is rendered."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from camera_sim.sim.belt import belt_depth, draw_belt
from camera_sim.sim.conditions import Conditions, StatedRest, draw_tuber_of
from camera_sim.sim.lowering import settled, underside_of
from camera_sim.sim.matched import matched
from camera_sim.sim.meshes import Faces, Vertices, rotation_about
from camera_sim.sim.optics import BASELINE_M
from camera_sim.sim.poses import free_rotation, rest_on_belt
from camera_sim.sim.presets import PRESETS, initial_rotation
from camera_sim.sim.raster import Canvas, Window, canvas_over, draw
from camera_sim.sim.stereo import NoiseBank, measure
from camera_sim.sim.tubers import Tuber, draw_odd_tuber, draw_tuber
from camera_sim.sim.view_setting import (
    TUBERS_PER_RECORDING,
    Recording,
    Setting,
    ViewPlan,
    draw_recording,
    draw_setting,
)
from camera_sim.sim.view_truth import Pose, Rim, pose_of, rim_of
from camera_sim.sim.world import rigid_between, to_the_right
from conveyor.geometry import Intrinsics, inverse_rigid, straight_down_belt_from_camera, transform_points

__all__ = ["SimulatedView", "ViewPlan", "ViewSimulator"]

MARGIN_PX = 14
MAX_CROP_PX = 460
FEWEST_PX = 150


@dataclass(frozen=True, slots=True)
class SimulatedView:
    """One tuber in one frame as a regressor gets it, with its truth.

    Attributes:
        depth: (h, w) uint16 in units of `depth_scale_m`, zero outside the mask; u0, v0 its place in the image.
        belt_distance_m: as the system believes it; the truth differs by the preset's error, of sd `belt_sd_m`.
        resting_m: how far its underside truly lies below the belt plane that the camera sees, here and now.
        pose, rim: how it lies and how much of its silhouette was lost.
        recording, conditions, stated: what it shares with the other tubers of its recording.
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
    resting_m: float
    pose: Pose
    rim: Rim
    recording: int
    conditions: Conditions
    stated: StatedRest


@dataclass(frozen=True, slots=True)
class _Lying:
    """A tuber as it lies for one view.

    Attributes:
        body: (V, 3) metres in belt coordinates, its box centred on x = y = 0; faces as the tuber's.
        settled_x_m: where along the belt's own period it lies; None where that does not matter.
    """

    body: Vertices
    pose: Pose
    settled_x_m: float | None


class ViewSimulator:
    """Makes views tuber by tuber; tuber `i` is the same whatever was made before it."""

    def __init__(self, plan: ViewPlan) -> None:
        self._plan = plan
        rng = np.random.default_rng([plan.seed, 0])
        self._bank = NoiseBank(rng, height=MAX_CROP_PX, width=MAX_CROP_PX)
        self._recording: Recording | None = None
        self._belts = [draw_belt(rng, soil_m=soil, cleat_m=cleat) for soil, cleat in ((8e-4, 0.0), (2e-3, 0.007))]

    def views(self, tuber_id: int) -> Iterator[SimulatedView]:
        """The views of tuber `tuber_id`; views in which nothing is left of it are not made, so there may be fewer."""
        plan = self._plan
        rng = np.random.default_rng([plan.seed, 1, tuber_id])
        recording = self._recording_of(tuber_id)
        tuber = _draw_tuber(plan, recording, rng)
        setting = draw_setting(plan, recording, self._belts, rng)
        preset = setting.preset
        start = initial_rotation(tuber.vertices, preset, rng)
        roll_axis = rotation_about(np.array([0.0, 0.0, 1.0]), rng.uniform(0, 2 * np.pi))[:, 0]
        roll_rad = np.radians(preset.roll_sd_deg) * float(np.clip(rng.standard_normal(), -2, 2))
        lift_m = abs(preset.lift_sd_m * rng.standard_normal())
        if setting.conditions.scatter_m > 0:
            lift_m += setting.conditions.scatter_m * float(rng.standard_normal())
        across = rng.uniform(-0.8, 0.8)
        shares = np.sort(_ride(rng, plan.views_per_tuber))
        for share in shares:
            rotation = rotation_about(roll_axis, roll_rad * share) @ start
            lying = _lie(tuber, rotation, setting, rng, lift_m=lift_m)
            view = self._view(tuber, tuber_id, lying, setting, share, across, rng)
            if view is not None:
                yield view

    def _recording_of(self, tuber_id: int) -> Recording:
        number = tuber_id // TUBERS_PER_RECORDING
        if self._recording is None or self._recording.number != number:
            self._recording = draw_recording(self._plan, number)
        return self._recording

    def _view(
        self,
        tuber: Tuber,
        tuber_id: int,
        lying: _Lying,
        setting: Setting,
        share: float,
        across: float,
        rng: Generator,
    ) -> SimulatedView | None:
        intrinsics, conditions = setting.optics.intrinsics, setting.conditions
        heave_m = conditions.heave_m * np.sin(rng.uniform(0, 2 * np.pi)) if conditions.heave_m > 0 else 0.0
        belt_from_camera = straight_down_belt_from_camera(setting.true_distance_m - heave_m)
        camera_from_belt = inverse_rigid(belt_from_camera)
        place = _place(lying.body, setting, share, across, clipped=rng.random() < self._plan.clipped_share)
        place[2] = _ground_m(setting, float(place[1]))
        points = transform_points(camera_from_belt, lying.body + place)
        window = _window_around(points, intrinsics)
        if window is None:
            return None
        travel_m = float(rng.uniform(0, 1))
        if lying.settled_x_m is not None:
            travel_m = float(place[0]) - lying.settled_x_m
        scene = _Scene(setting, belt_from_camera, travel_m, [(lying.body + place, tuber.faces)])
        if rng.random() < setting.preset.touched:
            scene.bodies.append(_neighbour(lying.body + place, rng))
        canvas = scene.seen(0.0, window)
        depth = _measured(canvas, scene, tuber.vertices, self._bank, rng)
        floor_m = rng.uniform(0.004, 0.009) if rng.random() < 0.7 else -1.0
        silhouette = canvas.ids == 1
        mask = _ragged_mask(silhouette, setting, self._bank, rng)
        mask &= depth > 0
        mask &= depth < (setting.seen_distance_m - floor_m) / setting.unit_m
        if np.count_nonzero(mask) < FEWEST_PX:
            return None
        crop, u0, v0 = _cropped(np.where(mask, depth, 0).astype(np.uint16), window)
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        return SimulatedView(
            depth=crop,
            u0=u0,
            v0=v0,
            depth_scale_m=setting.unit_m,
            intrinsics=intrinsics,
            belt_distance_m=setting.believed_distance_m,
            belt_sd_m=setting.preset.belt_sd_m,
            v_centre=float(intrinsics.fy * middle[1] / middle[2] + intrinsics.cy),
            tuber_id=tuber_id,
            tuber=tuber,
            resting_m=-float(lying.body[:, 2].min() + place[2]),
            pose=lying.pose,
            rim=rim_of(mask, silhouette),
            recording=setting.recording.number,
            conditions=conditions,
            stated=setting.recording.stated,
        )


def _draw_tuber(plan: ViewPlan, recording: Recording, rng: Generator) -> Tuber:
    odd = PRESETS[plan.preset].odd_share if plan.preset in PRESETS else 0.0
    if recording.conditions is not None and odd == 0:
        return draw_tuber_of(recording.conditions, rng)
    return draw_odd_tuber(rng) if odd > 0 and rng.random() < odd else draw_tuber(rng)


def _lie(tuber: Tuber, rotation: Vertices, setting: Setting, rng: Generator, *, lift_m: float) -> _Lying:
    """The tuber put down in its pose where it settles, `lift_m` above that."""
    body = rest_on_belt(tuber.vertices, rotation) + np.array([0.0, 0.0, lift_m])
    support, settled_x = setting.conditions.surface.support, None
    if support is not None:
        settled_x, z = settled(underside_of(body, tuber.faces), support, rng.uniform(0, support.period_m))
        body[:, 2] += z + lift_m
    body[:, 2] -= setting.conditions.beyond_m
    return _Lying(body, pose_of(rotation), settled_x)


def _ground_m(setting: Setting, y_m: float) -> float:
    """Height of the belt over its plane at `y_m` across, where it sags."""
    surface = setting.conditions.surface
    return float(surface.height_m(y_m)) if surface.sag_m > 0 else 0.0


@dataclass(frozen=True, slots=True)
class _Scene:
    """Belt and bodies under the camera at one moment; `bodies` are (V, 3) in belt coordinates with their faces."""

    setting: Setting
    belt_from_camera: NDArray[np.float64]
    travel_m: float
    bodies: list[tuple[Vertices, Faces]]

    def seen(self, aside_m: float, window: Window) -> Canvas:
        """What an imager so far to the right of the camera sees of a window; bodies are 1, 2."""
        belt_from_camera = to_the_right(self.belt_from_camera, aside_m)
        camera_from_belt = inverse_rigid(belt_from_camera)
        canvas = _background(self.setting, window, belt_from_camera, self.travel_m)
        for number, (vertices, faces) in enumerate(self.bodies, start=1):
            points = transform_points(camera_from_belt, vertices)
            draw(canvas, points, faces, intrinsics=self.setting.optics.intrinsics, instance=number)
        return canvas


def _measured(canvas: Canvas, scene: _Scene, at_home: Vertices, bank: NoiseBank, rng: Generator) -> NDArray[np.uint16]:
    """Depth of the canvas' window as the camera measures it; `at_home`: the tuber's vertices before it was laid."""
    window, setting = canvas.window, scene.setting
    bow, matching = setting.bow, setting.preset.matching
    if matching is not None:
        riding = scene.belt_from_camera.copy()
        riding[0, 3] -= scene.travel_m
        own = np.tile(riding, (len(scene.bodies) + 1, 1, 1))
        own[1] = rigid_between(scene.bodies[0][0], at_home) @ scene.belt_from_camera
        return matched(
            scene.seen,
            own,
            up=scene.belt_from_camera[2, :3],
            belt_m=setting.true_distance_m,
            intrinsics=setting.optics.intrinsics,
            window=window,
            unit_m=setting.unit_m,
            matching=matching,
            rng=rng,
        )
    if bow is not None:
        bow = bow[window.v0 : window.v0 + window.height, window.u0 : window.u0 + window.width]
    return measure(
        (1 / canvas.inverse_depth).astype(np.float32),
        focal_px=setting.optics.intrinsics.fx,
        unit_m=setting.unit_m,
        noise=setting.preset.noise,
        bank=bank,
        rng=rng,
        left_border=window.u0 == 0,
        bow=bow,
    )


def _ride(rng: Generator, views: int) -> NDArray[np.float64]:
    """Where along its ride through the image the tuber is seen, -1 to 1; 31 and more are spread evenly."""
    return np.linspace(-1, 1, views) if views >= 31 else rng.uniform(-1, 1, views)


def _place(body: Vertices, setting: Setting, share: float, across: float, *, clipped: bool) -> NDArray[np.float64]:
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


def _background(setting: Setting, window: Window, belt_from_camera: NDArray[np.float64], travel_m: float) -> Canvas:
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


def _neighbour(body: Vertices, rng: Generator) -> tuple[Vertices, Faces]:
    """Another tuber that touches `body`: as near as two bodies parted by an upright plane can be, and as far sunk."""
    other = draw_tuber(rng, level=3)
    turned = rest_on_belt(other.vertices, free_rotation(rng))
    heading = rng.uniform(0, 2 * np.pi)
    towards = np.array([np.cos(heading), np.sin(heading)])
    distance = float((body[:, :2] @ towards).max() - (turned[:, :2] @ towards).min())
    middle = (body[:, :2].max(axis=0) + body[:, :2].min(axis=0)) / 2
    centre = towards * (distance - float(middle @ towards)) + middle
    shifted = turned + np.array([centre[0], centre[1], min(0.0, float(body[:, 2].min()))])
    return shifted, other.faces


def _ragged_mask(mask: NDArray[np.bool_], setting: Setting, bank: NoiseBank, rng: Generator) -> NDArray[np.bool_]:
    """The mask as a segmenter gives it: its edge wanders, and it is a little too large or too small."""
    height, width = mask.shape
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    ragged = np.float32(setting.preset.ragged_px)
    du = columns + ragged * bank.take(bank.edge, rng, height, width)
    dv = rows + ragged * bank.take(bank.edge, rng, height, width)
    out = cv2.remap(mask.astype(np.uint8), du, dv, cv2.INTER_NEAREST)
    change = int(rng.choice(np.array(setting.preset.mask_px)))
    if change:
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * abs(change) + 1,) * 2)
        out = cv2.erode(out, kernel) if change < 0 else cv2.dilate(out, kernel)
    return _largest_part(np.asarray(out, np.uint8))


def _largest_part(mask: NDArray[np.uint8]) -> NDArray[np.bool_]:
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    if count < 2:
        return np.asarray(mask > 0)
    return np.asarray(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))


def _cropped(depth: NDArray[np.uint16], window: Window) -> tuple[NDArray[np.uint16], int, int]:
    """What is not zero, and its first column and row in the image."""
    rows, columns = np.nonzero(depth.any(axis=1))[0], np.nonzero(depth.any(axis=0))[0]
    v0, u0 = int(rows[0]), int(columns[0])
    return np.ascontiguousarray(depth[v0 : rows[-1] + 1, u0 : columns[-1] + 1]), window.u0 + u0, window.v0 + v0
