"""Harder belts: piles, webs of rods, tubers that move, and every fault by its name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from camera_sim.sim.faults import FAULTS, check_faults, plan_faults
from camera_sim.sim.optics import BASELINE_M
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings, build_world, layout_named
from camera_sim.sim.source import SimulatedSource, simulated_sources, truth_of
from camera_sim.sim.world import World, crossing_travel_m, render
from camera_sim.sim.worse import NOISE, WORLD, worsened
from conveyor.errors import InputError
from conveyor.formats import open_source


def _world(settings: SceneSettings, scene: str) -> tuple[World, list[SimulatedSource]]:
    settings = replace(settings, scene=scene)
    world = build_world(settings, layout_named(scene))
    return world, simulated_sources(world, settings, layout_named(scene))


def test_a_belt_too_short_for_a_frame_is_told_and_a_short_one_loses_what_there_is(
    small_settings: SceneSettings,
) -> None:
    """The first was an IndexError; of the second frames were lost that never were, and it told of -1."""
    with pytest.raises(InputError, match=r"the belt is done after 0\.\d+ s, before camera 'front' with 1 frames/s"):
        _world(replace(small_settings, tubers=1, fps=1.0, speed_mps=5.0), "touching")
    for frames in range(1, 12):
        plans = [
            plan_faults(np.random.default_rng(seed), frames=frames, fps=30.0, names=("dropped",), dropped=0.12)
            for seed in range(20)
        ]
        assert all(0 < seq < frames - 1 for plan in plans for seq in plan.missing), "not the first or the last"
        assert all(plan.missing for plan in plans) == (frames > 2)


def test_moving_tubers_are_where_the_truth_says_when_they_cross(small_settings: SceneSettings) -> None:
    world, sources = _world(replace(small_settings, tubers=10), "rolling")
    camera = world.cameras[0]
    rows = {row["id"]: row for row in truth_of(world, sources)["tubers"]}
    assert len(rows) == 10
    wandered_m = []
    for body in world.bodies:
        travel = crossing_travel_m(body, camera)
        assert travel is not None
        row, place = rows[body.body_id], body.place_at(travel)
        assert (row["place_x_m"], row["place_y_m"]) == pytest.approx(tuple(place[:2]), abs=1e-5)
        there = body.vertices_at(travel)
        assert (there.min(axis=0) + there.max(axis=0))[:2] / 2 == pytest.approx(place[:2], abs=1e-9)
        v, _ = np.nonzero(render(world, camera, travel).ids == body.body_id)
        k = camera.optics.intrinsics
        assert abs(v.mean() - k.cy) < 1 + 0.15 * np.ptp(body.vertices, axis=0).max() / 0.46 * k.fy
        for beyond in (-0.15, 0.15):
            moved = body.vertices_at(travel + beyond)
            assert moved[:, 2].min() == pytest.approx(body.vertices[:, 2].min(), abs=1e-9)  # it stays on the belt
            wandered_m.append(float(np.linalg.norm(body.place_at(travel + beyond) - place)))
            sides = np.linalg.norm(moved[::40] - moved[0], axis=1)
            assert sides == pytest.approx(np.linalg.norm(body.vertices[::40] - body.vertices[0], axis=1))  # rigid
    assert 0.002 < np.median(wandered_m) < 0.012
    assert max(wandered_m) < 0.06


def test_clods_and_stones_move_as_tubers_do_and_haulm_lies_still(small_settings: SceneSettings) -> None:
    still = replace(small_settings, tubers=24)
    world, sources = _world(replace(still, unrest=1.0), "distractors")
    moves = {kind: {body.drift is not None for body in world.bodies if body.kind == kind} for kind in ("clod", "stone")}
    assert moves == {"clod": {True}, "stone": {True}}
    assert {body.drift is None for body in world.bodies if body.kind in ("haulm", "leaf")} == {True}
    at_rest, _ = _world(still, "distractors")
    for body, resting in zip(world.bodies, at_rest.bodies, strict=True):
        assert np.array_equal(body.vertices, resting.vertices)
    camera = world.cameras[0]
    others = [body for body in world.bodies if body.kind != "tuber" and crossing_travel_m(body, camera) is not None]
    for row, body in zip(truth_of(world, sources)["distractor_places"], others, strict=True):
        travel = crossing_travel_m(body, camera)
        assert travel is not None
        assert (row["place_x_m"], row["place_y_m"]) == pytest.approx(tuple(body.place_at(travel)[:2]), abs=1e-5)


def test_piled_tubers_lie_on_others_and_in_none(small_settings: SceneSettings) -> None:
    world, sources = _world(replace(small_settings, tubers=30), "piled")
    assert len(truth_of(world, sources)["tubers"]) == 30
    upper = [body for body in world.bodies if body.layer == 2]
    assert 6 <= len(upper) <= 9  # a few of the nine found a gap and lie on the belt
    for body in upper:
        below = _heights(world, without=body.body_id, like=body.vertices)
        gap_m = body.vertices[:, 2] - below
        assert gap_m.min() > -0.004  # they touch, but for the steps of their meshes
        assert gap_m.min() < 0.004
        assert body.vertices[:, 2].min() >= 0


def _heights(world: World, *, without: int, like: np.ndarray) -> np.ndarray:
    """Highest surface under each vertex, among bodies that came before."""
    from camera_sim.sim.pile import CELL_M, Ground

    low, high = like.min(axis=0) - 0.3, like.max(axis=0) + 0.3
    ground = Ground(x_m=(low[0], high[0]), y_m=(low[1], high[1]))
    for body in world.bodies:
        near = (body.vertices.min(axis=0) > low)[:2].all() and (body.vertices.max(axis=0) < high)[:2].all()
        if body.body_id < without and near:
            ground.add(body.vertices, body.faces)
    cells = ((like[:, :2] - low[:2]) / CELL_M).astype(int)
    return ground._height[cells[:, 0], cells[:, 1]]


def test_between_rods_one_sees_what_is_below(small_settings: SceneSettings) -> None:
    world, _ = _world(small_settings, "rods")
    depth = 1 / render(world, world.cameras[0], -1.0).inverse_depth  # nothing lies there yet
    below = depth > small_settings.belt_distance_m + 0.030
    on_rods = np.abs(depth - small_settings.belt_distance_m) < 0.008
    assert 0.5 < below.mean() < 0.72  # 20 of 32 mm
    assert (below | on_rods).mean() > 0.99
    rows = below.mean(axis=1) > 0.5
    assert np.count_nonzero(np.diff(rows.astype(int)) == 1) == pytest.approx(16, abs=2)  # 0.51 m of belt, 32 mm apart


def test_each_fault_changes_the_recording(small_settings: SceneSettings) -> None:
    """The small camera sees 4 times fewer pixels a millimetre than the D405, so its depth errors are 4 times larger."""
    layout = layout_named("touching")
    settings = replace(small_settings, tubers=2)
    world = build_world(settings, layout)
    good = simulated_sources(world, settings, layout)[0].frame(8, run="a")
    good_mm = good.depth * good.depth_scale_m * 1000
    for name in (*NOISE, "belt-jitter", "fine-unit"):
        worse = worsened(settings, (name,))
        worse_world = build_world(worse, layout) if name == "belt-jitter" else world
        bad = simulated_sources(worse_world, worse, layout)[0].frame(8, run="a")
        bad_mm = bad.depth * bad.depth_scale_m * 1000
        assert not np.array_equal(good_mm, bad_mm), name
        both = (good_mm > 0) & (bad_mm > 0)
        assert np.median(np.abs(good_mm - bad_mm)[both]) < 12.0, name  # it is still the same scene
        if "holes" in name:
            assert (bad_mm == 0).sum() > (good_mm == 0).sum() + 50, name
        assert bad.depth_scale_m == (0.0001 if name == "fine-unit" else 0.001)


def test_dirt_on_the_lens_hides_the_same_spots_in_every_frame(small_settings: SceneSettings) -> None:
    layout = layout_named("touching")
    world = build_world(small_settings, layout)
    clean, dirty = (
        [
            frame.depth == 0
            for frame in simulated_sources(world, small_settings, layout, faults=faults)[0].frames(run="a")
        ]
        for faults in ((), ("dirty-lens",))
    )
    always = np.logical_and.reduce(dirty)
    assert always.mean() > np.logical_and.reduce(clean).mean() + 0.003
    assert all(np.array_equal(a | always, b) for a, b in zip(clean, dirty, strict=True))


def test_an_unsteady_belt_swings_about_its_speed(small_settings: SceneSettings) -> None:
    settings = worsened(replace(small_settings, tubers=30), ("belt-jitter",))
    steps = np.diff(build_world(settings, layout_named("touching")).motion.travel_m) / 0.001
    assert 0.05 < steps.std() / settings.speed_mps < 0.15
    assert steps.mean() == pytest.approx(settings.speed_mps, rel=0.05)
    assert steps.min() >= 0


def test_a_recording_that_claims_the_wrong_unit_is_refused_when_it_is_read(
    small_settings: SceneSettings, tmp_path: Path
) -> None:
    record_scene(tmp_path / "r", replace(small_settings, tubers=1), faults=("wrong-scale",))
    with pytest.raises(InputError, match=r"depth_scale_m is 0\.001 and should be 0\.0001"):
        list(open_source(tmp_path / "r").frames(run="x"))


def test_fault_names_are_forgiving_and_unknown_ones_are_not() -> None:
    assert check_faults(("clock jump", "Clock_Jump", "holes")) == ("clock-jump", "clock-jump", "holes")
    assert set(check_faults((*FAULTS, *NOISE, *WORLD))) == {*FAULTS, *NOISE, *WORLD}
    with pytest.raises(InputError, match=r"--inject fire is unknown; known: dropped, .*dirty-lens, .*rolling"):
        check_faults(("fire",))


@pytest.mark.parametrize("fault", ["depth-drift", "mount-moves"])
def test_a_camera_that_drifts_or_moves_sees_it_grow_evenly(small_settings: SceneSettings, fault: str) -> None:
    """A drift of disparity of 0.4 px, a move of 6 mm. Stated is the belt as it was at first."""
    settings = worsened(replace(small_settings, belt_distance_m=0.46, unit_m=0.0001), (fault,))
    (source,) = _world(settings, "singulated")[1]
    (still,) = _world(replace(settings, drift_by_end_px=0.0, shift_by_end_mm=0.0), "singulated")[1]
    assert source.description.belt_distance_m == still.description.belt_distance_m
    strength = source.description.intrinsics.fx * BASELINE_M
    last = (source.description.frames or 1) - 1
    for seq, share in ((0, 0.0), (last // 2, (last // 2) / last), (last, 1.0)):
        depth, before = source.frame(seq, run="r").depth, still.frame(seq, run="r").depth
        belt = (depth > 4100) & (before > 4450)
        seen_m = 1 / (1 / 0.46 + share * 0.4 / strength) if fault == "depth-drift" else 0.46 + share * 0.006
        off_mm = 0.1 * (depth[belt].mean() - before[belt].mean())
        assert off_mm == pytest.approx(1000 * (seen_m - 0.46), abs=0.5), seq
