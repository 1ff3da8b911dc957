"""Worlds by recording: what is drawn, what is shared, and that the old presets are what they were."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from camera_sim.sim import conditions as c
from camera_sim.sim.conditions import Conditions, draw_conditions, draw_stated, draw_tuber_of
from camera_sim.sim.presets import HARSH_PRESET
from camera_sim.sim.record import record_scene, world_truth
from camera_sim.sim.scenes import SceneSettings, build_world, in_its_world
from camera_sim.sim.source import simulated_sources, truth_of
from camera_sim.sim.stereo import EASY, StereoNoise
from camera_sim.sim.surface import FLAT
from camera_sim.sim.tubers import draw_tuber
from camera_sim.sim.view_setting import TUBERS_PER_RECORDING, ViewPlan
from camera_sim.sim.viewpack import packed
from camera_sim.sim.views import ViewSimulator
from conveyor.formats import open_source
from conveyor.formats.packs.views import pack_views
from conveyor.messages import Frame
from tuberline.demo import DEMO_LAYOUT, DEMO_SETTINGS

VIEWS_BEFORE = {
    "easy": "cd5b6688777f8669d43d0259ff697f0ff3de32264201fb0198511121c6852cca",
    "field": "ec3633f888d8d8a003a25a132c45be00ffbaaeeff1e524a3deb22f67d5414cd5",
    "mixed": "4c79ac42b81b3cc1bcdd09c37051a57ff4a459ee723a4f0442ed40b6980556c3",
}
"""Of all arrays that packs had before recordings had worlds, as they were then."""
ARRAYS_BEFORE = (
    *("depth", "depth_offset", "crop", "depth_scale_m", "intrinsics", "image_size", "belt_distance_m", "belt_sd_m"),
    *("weight_g", "volume_ml", "length_mm", "width_mm", "height_mm", "tuber", "cultivar", "season", "v_centre"),
)
DEMO_BEFORE = "6241011061ecfe0c14a94762398bbdafd9b42c131c18b38b89c369fbbcef5b4f"


def digest_of_recording(folder: Path) -> str:
    """Of all names and contents under `folder`."""
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(path.relative_to(folder).as_posix().encode())
        if path.suffix == ".png":
            digest.update(np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)).tobytes())
        else:
            digest.update(path.read_bytes())
    return digest.hexdigest()


@pytest.mark.parametrize("preset", list(VIEWS_BEFORE))
def test_views_of_the_old_presets_are_what_they_were(preset: str) -> None:
    plan = ViewPlan(seed=3, views_per_tuber=4, preset=preset, distance_range_m=(0.3, 0.55), fine_unit_share=0.2)
    simulator = ViewSimulator(plan)
    arrays = pack_views([packed(view) for tuber in range(12) for view in simulator.views(tuber)])
    digest = hashlib.sha256()
    for name in ARRAYS_BEFORE:
        array = arrays[name]
        # The last bits of a product of matrices differ between processors; no pixel does.
        rounded = np.round(array, 6) if array.dtype.kind == "f" else array
        digest.update(name.encode() + rounded.tobytes())
    assert digest.hexdigest() == VIEWS_BEFORE[preset]


def test_the_demo_recording_is_what_it_was() -> None:
    """Its truth but for what came later (mesh sizes, foreign bodies), its cameras and every 15th frame."""
    settings = in_its_world(DEMO_SETTINGS, DEMO_LAYOUT)
    world = build_world(settings, DEMO_LAYOUT)
    sources = simulated_sources(world, settings, DEMO_LAYOUT)
    truth = {**truth_of(world, sources), **world_truth(settings, DEMO_LAYOUT)}
    del truth["foreign"]
    for tuber in truth["tubers"]:
        del tuber["square_mesh_mm"]
    digest = hashlib.sha256(json.dumps(truth).encode())
    for source in sources:
        digest.update(f"{source.description.belt_distance_m} {source.description.frames}".encode())
        for seq in range(0, source.description.frames or 0, 15):
            frame = source.frame(seq, run="demo")
            digest.update(f"{seq} {frame.captured_ns} {frame.travel_m}".encode() + frame.depth.tobytes())
    assert digest.hexdigest() == DEMO_BEFORE


@pytest.fixture(scope="module")
def harsh() -> list[Conditions]:
    return [draw_conditions("harsh", np.random.default_rng([77, n])) for n in range(300)]


def _spans(values: list[float], limits: tuple[float, float]) -> None:
    """All within the limits, and both ends are reached but for a tenth of the range."""
    slack = 0.1 * (limits[1] - limits[0])
    assert limits[0] - 1e-12 <= min(values) < limits[0] + slack, limits
    assert limits[1] - slack < max(values) <= limits[1] + 1e-12, limits


def test_harsh_spans_what_real_cameras_and_belts_showed(harsh: list[Conditions]) -> None:
    noises = [world.preset.noise for world in harsh]
    _spans([world.local_px or 0.0 for world in harsh], c.LOCAL_PX)
    _spans([noise.smooth_px for noise in noises], c.SMOOTH_PX)
    _spans([noise.bow_px for noise in noises], c.BOW_PX)
    _spans([noise.islands for noise in noises], c.ISLANDS)
    _spans([noise.rim_px for noise in noises], (0.0, c.RIM_PX[1]))
    _spans([noise.steep for noise in noises], c.STEEP)
    _spans([noise.bare for noise in noises], c.BARE)
    _spans([noise.scale for noise in noises], c.SCALE)
    _spans([noise.drift_px for noise in noises], c.DRIFT_PX)
    _spans([world.resting_m for world in harsh], c.RESTING_M)
    _spans([world.jacket_m for world in harsh], (0.0, c.JACKET_M[1]))
    _spans([world.heave_m for world in harsh], (0.0, c.HEAVE_M[1]))
    for kind, share in c.SURFACES.items():
        assert abs(np.mean([world.surface.kind == kind for world in harsh]) - share) < 0.09, kind
    assert len({world.stock for world in harsh}) == 7
    assert np.mean([world.resting_m for world in harsh if world.surface.kind == "flat"]) == pytest.approx(
        3.5e-3, abs=1e-3
    )


def test_what_a_user_states_is_as_far_off_as_he_says(harsh: list[Conditions]) -> None:
    stated = [draw_stated(world, np.random.default_rng([78, n])) for n, world in enumerate(harsh)]
    off = np.array([(world.resting_m - rest.offset_m) / rest.sd_m for world, rest in zip(harsh, stated, strict=True)])
    calibrated = np.array([rest.calibrated for rest in stated])
    assert calibrated.mean() == pytest.approx(c.CALIBRATED_SHARE, abs=0.08)
    for which in (calibrated, ~calibrated):
        assert np.sqrt((off[which] ** 2).mean()) == pytest.approx(1.0, abs=0.15)


def test_the_mixture_draws_all_presets_and_leaves_easy_easy() -> None:
    worlds = [draw_conditions("worlds", np.random.default_rng([79, n])) for n in range(200)]
    for name, share in c.WORLDS.items():
        assert abs(np.mean([world.preset.name == name for world in worlds]) - share) < 0.1
    easy = next(world for world in worlds if world.preset.name == "easy")
    assert (easy.preset.noise, easy.surface, easy.resting_m, easy.jacket_m, easy.heave_m) == (EASY, FLAT, 0.0, 0.0, 0.0)
    assert easy.stock is not None


def test_what_would_fall_through_the_rods_is_drawn_again(harsh: list[Conditions]) -> None:
    world, rods = next((w, r) for w in harsh if (r := w.surface.rods) is not None and 1000 * r.gap_m > 35)
    some = [draw_tuber(np.random.default_rng([80, n]), level=2) for n in range(60)]
    slim = next(tuber for tuber in some if tuber.axes_mm[1] <= 1000 * rods.gap_m)
    stout = next(tuber for tuber in some if tuber.axes_mm[1] > 1000 * rods.gap_m)
    coming = iter([slim, stout])
    found = draw_tuber_of(replace(world, jacket_m=0.0), np.random.default_rng(1), draw=lambda _: next(coming))
    assert found is stout


def test_tubers_of_a_recording_share_its_world_and_those_of_another_do_not() -> None:
    plan = ViewPlan(seed=4, views_per_tuber=1, preset="harsh")
    simulator = ViewSimulator(plan)
    tubers = (0, 7, TUBERS_PER_RECORDING - 1, TUBERS_PER_RECORDING, TUBERS_PER_RECORDING + 3)
    views = [next(iter(simulator.views(tuber))) for tuber in tubers]
    assert [view.recording for view in views] == [0, 0, 0, 1, 1]
    for one, other in ((0, 1), (1, 2), (3, 4)):
        for name in ("conditions", "stated", "intrinsics", "belt_distance_m", "depth_scale_m"):
            assert getattr(views[one], name) == getattr(views[other], name), name
        assert views[one].tuber.stock == views[other].tuber.stock
    assert views[0].conditions != views[3].conditions
    again = next(iter(ViewSimulator(plan).views(tubers[-1])))
    assert np.array_equal(again.depth, views[-1].depth)


def test_a_harsh_recording_states_what_a_user_would_and_the_truth_says_more(
    small_settings: SceneSettings, tmp_path: Path
) -> None:
    settings = replace(small_settings, preset=HARSH_PRESET, tubers=3, seed=6)
    truth = record_scene(tmp_path / "a", settings)
    record_scene(tmp_path / "b", settings)
    assert digest_of_recording(tmp_path / "a") == digest_of_recording(tmp_path / "b")
    camera = json.loads((tmp_path / "a" / "front" / "camera.json").read_text())
    written = json.loads((tmp_path / "a" / "truth.json").read_text())
    assert camera["resting_offset_mm"] == written["stated_resting_offset_mm"]
    assert camera["resting_sd_mm"] == written["resting_sd_mm"] > 0
    assert -2 <= written["resting_offset_mm"] <= 9
    assert written["preset"] == "harsh"
    assert {row["cultivar"] for row in truth["tubers"]} == {written["world"]["cultivar"]}
    assert written["world"]["noise"]["scale"] != 1.0
    stated_m = small_settings.belt_distance_m
    noise = StereoNoise(scale=written["world"]["noise"]["scale"], drift_px=written["world"]["noise"]["drift_px"])
    seen_m = noise.seen_m(stated_m, focal_px=small_settings.optics.intrinsics.fx)
    assert camera["belt_distance_m"] == pytest.approx(
        seen_m, abs=0.006
    )  # its belt error is 2 mm sd, cut at two of them
    assert sum(isinstance(frame, Frame) for frame in open_source(tmp_path / "a").frames(run="x")) > 10


def test_a_flat_recording_states_nothing_and_one_that_was_lowered_does(
    small_settings: SceneSettings, tmp_path: Path
) -> None:
    for name, offset_mm in (("flat", 0.0), ("low", 5.5)):
        settings = replace(small_settings, tubers=1, resting_offset_mm=offset_mm)
        truth = record_scene(tmp_path / name, settings)
        camera = json.loads((tmp_path / name / "front" / "camera.json").read_text())
        said = {key: value for key, value in {**camera, **truth}.items() if "resting" in key}
        if offset_mm == 0:
            assert said == {}
        else:
            assert (camera["resting_offset_mm"], camera["resting_sd_mm"]) == (5.5, 0.5)
            assert truth["resting_offset_mm"] == 5.5


def test_a_recording_of_views_says_what_was_true_and_what_was_stated() -> None:
    plan = ViewPlan(seed=9, views_per_tuber=2, preset="harsh")
    simulator = ViewSimulator(plan)
    arrays = pack_views([packed(view) for tuber in range(0, 200, 9) for view in simulator.views(tuber)])
    own_mm = arrays["resting_mm"] - arrays["resting_recording_mm"]
    level = arrays["surface"] == "flat"
    assert level.sum() > 5
    assert np.abs(own_mm[level]).max() < 3.5 * c.SCATTER_M[1] * 1000  # each tuber's own level alone
    assert (arrays["surface"] != "flat").sum() > 5
    assert set(arrays["pose"]) == {"flat", "tilted", "standing"}
    assert set(arrays["rim"]) <= {"exact", "good", "poor"}
    assert (arrays["rim_lost"][arrays["rim"] == "poor"] >= 0.10).all()
    per_recording = {key: {} for key in ("stated_resting_mm", "stated_resting_sd_mm", "resting_recording_mm")}
    for key, seen in per_recording.items():
        for number, value in zip(arrays["recording"].tolist(), arrays[key].tolist(), strict=True):
            assert seen.setdefault(number, value) == value, key
