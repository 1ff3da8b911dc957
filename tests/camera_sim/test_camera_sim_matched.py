"""A camera whose depth a stereo matcher makes of two images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from camera_sim.sim.belt_scenes import random_belt_views
from camera_sim.sim.conditions import draw_matching
from camera_sim.sim.drift import draw_drift
from camera_sim.sim.matched import Matching, matched
from camera_sim.sim.meshes import rotation_about
from camera_sim.sim.optics import BASELINE_M, D405_848, D405_1280
from camera_sim.sim.presets import EASY_PRESET, MATCHED_PRESET
from camera_sim.sim.raster import Canvas, Window, canvas_over
from camera_sim.sim.scenes import SceneSettings, build_world, in_its_world, layout_named
from camera_sim.sim.source import SimulatedSource, simulated_sources
from camera_sim.sim.stereo import EASY
from camera_sim.sim.views import SimulatedView, ViewPlan, ViewSimulator
from camera_sim.sim.world import own_frames, render, rigid_between
from camera_sim.sim.worse import NOISE, worsened
from conveyor.errors import InputError
from conveyor.geometry import straight_down_belt_from_camera, transform_points
from conveyor.messages import Frame

SEED = 11
CLEAR = Matching(contrast=0.3, noise=1.0, texture=4)


def _source(settings: SceneSettings, **changed: object) -> SimulatedSource:
    settings = replace(settings, unit_m=0.0001, **changed)
    layout = layout_named("touching")
    (source,) = simulated_sources(build_world(settings, layout), settings, layout)
    return source


@pytest.fixture
def matched_settings(small_settings: SceneSettings) -> SceneSettings:
    return replace(small_settings, optics=D405_848, preset=replace(MATCHED_PRESET, matching=CLEAR))


def _frame(source: SimulatedSource, seq: int) -> Frame:
    return source.frame(seq, run="test")


def _error_mm(source: SimulatedSource, seq: int) -> tuple[np.ndarray, np.ndarray]:
    """(h, w) depth less the truth, millimetres, and where a body is."""
    world, camera = source._world, source._camera
    canvas = render(world, camera, world.motion.travel_at(source.time_s(seq)), time_s=source.time_s(seq))
    frame = _frame(source, seq)
    error = frame.depth * frame.depth_scale_m - 1 / canvas.inverse_depth
    return np.where(frame.depth > 0, error * 1000, np.nan), canvas.ids > 0


def test_belt_and_skin_are_read_to_a_millimetre(matched_settings: SceneSettings) -> None:
    source = _source(matched_settings)
    error, body = _error_mm(source, source._count // 2)
    border = int(matched_settings.optics.intrinsics.fx * BASELINE_M / matched_settings.belt_distance_m)
    assert np.isnan(error[:, :border]).all(), "the right imager does not see the left border"
    inner = error[20:-20, border + 20 : -20]
    assert np.isfinite(inner).mean() > 0.85
    assert abs(np.nanmedian(inner[~body[20:-20, border + 20 : -20]])) < 0.5
    on_bodies = error[body & np.isfinite(error)]
    assert len(on_bodies) > 5000
    assert np.median(np.abs(on_bodies)) < 1.5


def test_errors_stay_on_the_skin_and_drawn_ones_do_not(
    matched_settings: SceneSettings, small_settings: SceneSettings
) -> None:
    """The belt moves by whole pixels between two frames, so what is seen is the same again, and noise is not."""
    rows = 8
    step_m = rows * matched_settings.belt_distance_m / matched_settings.optics.intrinsics.fy
    sharp = replace(EASY_PRESET, noise=replace(EASY, blur_px=0.0, edge_px=0.0, smooth_px=0.0))
    agreed = {}
    for name, settings in {
        "matched": matched_settings,
        "drawn": replace(small_settings, optics=D405_848, preset=sharp),
    }.items():
        source = _source(settings, jitter=0.0, speed_mps=step_m * settings.fps)
        (first, body), (later, _) = _error_mm(source, 20), _error_mm(source, 21)
        a, b = first[:-rows], later[rows:]
        known = ~body[:-rows] & (np.abs(a) < 5) & (np.abs(b) < 5)
        agreed[name] = np.corrcoef(a[known], b[known])[0, 1]
    assert agreed["matched"] > 0.6, agreed
    assert agreed["drawn"] < 0.3, agreed


def test_marks_move_with_a_body_that_rolls(matched_settings: SceneSettings, rng: np.random.Generator) -> None:
    source = _source(matched_settings)
    world, camera = source._world, source._camera
    body = world.bodies[0]
    rolling = replace(body, drift=replace(draw_drift(rng, body.vertices, strength=1.0), roll_rad_per_m=3.0))
    world = replace(world, bodies=(rolling, *world.bodies[1:]))
    travel_m = -float(body.place[0]) + 0.1
    points = rolling.vertices_at(travel_m) + np.array([travel_m, 0.0, 0.0])
    seen = transform_points(np.linalg.inv(camera.belt_from_camera), points)
    own = own_frames(world, camera, travel_m)
    assert np.abs(transform_points(own[body.body_id], seen) - body.vertices).max() < 1e-6
    assert not np.allclose(own[body.body_id], own[0]), "it lay still"


def test_a_rigid_motion_is_found_again(rng: np.random.Generator) -> None:
    start = rng.normal(size=(50, 3))
    turn = rotation_about(np.array([0.6, 0.0, 0.8]), 2.0)
    found = rigid_between(start, start @ turn.T + np.array([0.1, -0.2, 0.3]))
    assert np.allclose(found[:3, :3], turn)
    assert np.allclose(found[:3, 3], [0.1, -0.2, 0.3])


def test_a_frame_is_the_same_whatever_came_before_it(matched_settings: SceneSettings) -> None:
    one, other = _source(matched_settings), _source(matched_settings)
    _frame(one, 3)
    assert np.array_equal(_frame(one, 30).depth, _frame(other, 30).depth)


def test_each_recording_has_a_camera_of_its_own(small_settings: SceneSettings, rng: np.random.Generator) -> None:
    layout = layout_named("touching")
    cameras = {
        in_its_world(replace(small_settings, preset=MATCHED_PRESET, seed=seed), layout).preset.matching
        for seed in (1, 2, 3)
    }
    assert len(cameras) == 3
    drawn = [draw_matching(rng) for _ in range(100)]
    assert all(camera.window_px % 2 for camera in drawn)
    assert {camera.semi_global for camera in drawn} == {True, False}


@pytest.mark.parametrize("name", [*NOISE, "depth-drift"])
def test_errors_that_are_not_drawn_are_not_made_worse(matched_settings: SceneSettings, name: str) -> None:
    with pytest.raises(InputError, match=f"--inject {name} changes errors that are drawn"):
        worsened(matched_settings, (name,))
    assert worsened(matched_settings, ("mount-moves",)).shift_by_end_mm > 0


def test_single_views_are_of_such_cameras_and_repeat(tmp_path: Path) -> None:
    def views() -> list[SimulatedView]:
        simulator = ViewSimulator(ViewPlan(seed=3, views_per_tuber=2, preset="matched"))
        return [view for tuber in (0, 30) for view in simulator.views(tuber)]

    made = views()
    assert len(made) == 4
    assert len({view.conditions.preset.matching for view in made}) == 2, "one camera a recording"
    assert all(np.array_equal(a.depth, b.depth) for a, b in zip(made, views(), strict=True))
    for view in made:
        top_m = view.belt_distance_m - view.depth[view.depth > 0].min() * view.depth_scale_m
        assert 0.01 < top_m < 0.12


@pytest.mark.parametrize("semi_global", [False, True])
def test_the_left_of_a_window_is_matched_however_wide_the_baseline(semi_global: bool) -> None:
    """A matcher sees nothing as far from the left as the disparities are that it looks for: here 33 pixels."""
    k, belt_m, top_m = D405_1280.intrinsics, 0.345, 0.075
    matching = replace(CLEAR, baseline_m=0.055, semi_global=semi_global)

    def show(aside_m: float, window: Window) -> Canvas:
        depth_m = np.full((window.height, window.width), belt_m, np.float32)
        first, last = (round(k.cx + k.fx * (x_m - aside_m) / (belt_m - top_m)) - window.u0 for x_m in (-0.02, 0.02))
        depth_m[:, max(first, 0) : max(last, 0)] = belt_m - top_m
        return canvas_over(depth_m, window)

    window = Window(round(k.cx - k.fx * 0.02 / (belt_m - top_m)), 300, 80, 90)
    depth = matched(
        show,
        np.array([straight_down_belt_from_camera(belt_m)]),
        up=np.array([0.0, 0.0, -1.0]),
        belt_m=belt_m,
        intrinsics=k,
        window=window,
        unit_m=0.0001,
        matching=matching,
        rng=np.random.default_rng(SEED),
    )
    seen = depth[:, 4:10]
    assert (seen > 0).mean() > 0.9, f"seed {SEED}"
    assert np.median(seen[seen > 0]) * 0.0001 == pytest.approx(belt_m - top_m, abs=0.0005), f"seed {SEED}"


def test_belts_for_the_classifier_have_them_on_request() -> None:
    plain = next(random_belt_views(9, 0, frames=1, tubers=4, hard_negatives=True))
    as_ever = next(random_belt_views(9, 0, frames=1, tubers=4, hard_negatives=True, matched=0.0))
    assert np.array_equal(plain.depth, as_ever.depth)
    matched = next(random_belt_views(9, 0, frames=1, tubers=4, hard_negatives=True, matched=1.0))
    again = next(random_belt_views(9, 0, frames=1, tubers=4, hard_negatives=True, matched=1.0))
    assert np.array_equal(matched.depth, again.depth)
    assert not np.array_equal(plain.depth, matched.depth)
