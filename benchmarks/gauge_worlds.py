"""Simulated belts with a gauge in view, whose camera is moved and whose disparity is shifted while they run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from camera_sim.sim.conditions import draw_conditions
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.rods import Rods
from camera_sim.sim.scenes import SceneSettings, build_world, in_its_world, layout_named
from camera_sim.sim.source import SimulatedSource
from camera_sim.sim.surface import FLAT, Surface
from camera_sim.sim.world import Body, Edges, World
from conveyor.gauge import Gauge, GaugeKind

BAR_M, BAR_PLACE_M = (0.30, 0.06), (0.0, -0.24, 0.12)
"""A bar 300 mm long and 60 mm wide beside the load, its top 120 mm over the belt."""
BELT_M = 0.78
PITCHES_M = (0.028, 0.032, 0.036, 0.040, 0.045, 0.050)
FPS = 10.0
SHAKE_M = (0.0005, 0.003)
"""How far the belt swings up and down, as half of the belts of `harsh` do: one that stood still would hide up to half a
step of disparity, 0.4 mm at 0.46 m."""


@dataclass(frozen=True, slots=True)
class Disturbed:
    """What befalls the camera after it was calibrated: `shift_m` farther from the belt, `drift_px` more disparity."""

    shift_m: float = 0.0
    drift_px: float = 0.0


@dataclass(frozen=True, slots=True)
class GaugeWorld:
    """One belt and its camera, calibrated as it is undisturbed."""

    settings: SceneSettings
    world: World
    gauge: Gauge

    def source(self, by: Disturbed) -> SimulatedSource:
        """The camera after `by`; its belt distance is the one that it was calibrated to, its bow the same."""
        camera = self.world.cameras[0]
        moved = camera.belt_from_camera.copy()
        moved[:3, 3] -= moved[:3, 2] * by.shift_m
        noise = replace(self.settings.preset.noise, drift_px=by.drift_px)
        settings = replace(self.settings, preset=replace(self.settings.preset, noise=noise))
        layout = layout_named(settings.scene)
        return SimulatedSource(self.world, replace(camera, belt_from_camera=moved), settings, layout=layout)


def gauge_world(kind: GaugeKind, seed: int, *, preset: str, tubers: int) -> GaugeWorld:
    """A belt with a gauge of that kind in view. Its camera is one of the preset's, its depth is right at first."""
    rng = np.random.default_rng([seed, 171])
    layout = layout_named("singulated")
    settings = SceneSettings("singulated", seed, tubers, PRESETS[preset], fps=FPS, unit_m=0.001, speed_mps=0.25)
    pitch_m = float(rng.choice(np.array(PITCHES_M)))
    surface = Surface("rods", rods=Rods(0.006, pitch_m, float(rng.uniform(0.03, 0.15)))) if kind == "rods" else FLAT
    conditions = replace(draw_conditions(preset, rng), surface=surface)
    if conditions.stock is not None and kind == "rods":
        conditions = replace(conditions, resting_m=0.0, beyond_m=0.0)
    noise = replace(conditions.preset.noise, drift_px=0.0, scale=1.0)
    right = replace(conditions.preset, noise=noise, belt_error_session_m=0.0, belt_error_tuber_m=0.0)
    shake_m = float(rng.uniform(*SHAKE_M))
    settings = replace(
        settings,
        heave_mm=1000 * shake_m,
        heave_hz=float(rng.uniform(2.0, 6.0)),
        conditions=replace(conditions, preset=right, heave_m=shake_m),
        preset=right,
    )
    settings = in_its_world(settings, layout)
    world = build_world(settings, layout)
    if kind == "belt-width":
        world = replace(world, edges=Edges(BELT_M))
        return GaugeWorld(settings, world, Gauge("belt-width", width_m=BELT_M))
    if kind == "rods":
        return GaugeWorld(settings, world, Gauge("rods", pitch_m=pitch_m, rod_m=0.012))
    world = replace(world, fixed=(_bar(),))
    return GaugeWorld(settings, world, Gauge("bar", size_m=BAR_M, place_m=BAR_PLACE_M))


def _bar() -> Body:
    """A box whose top is the bar's; what it stands on is beside the belt."""
    half = np.array([BAR_M[0] / 2, BAR_M[1] / 2, 0.01])
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * half
    corners += np.array(BAR_PLACE_M) - np.array([0, 0, 0.01])
    hull = ConvexHull(corners)
    inward = np.einsum("ij,ij->i", np.cross(*_sides(corners, hull.simplices)), hull.equations[:, :3]) < 0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices).astype(np.int32)
    return Body(9999, "gauge", corners, faces, None)


def _sides(corners: NDArray[np.float64], faces: NDArray[np.int32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return corners[faces[:, 1]] - corners[faces[:, 0]], corners[faces[:, 2]] - corners[faces[:, 0]]
