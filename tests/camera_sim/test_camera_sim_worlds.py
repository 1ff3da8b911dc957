"""Worlds by recording: what is drawn, what is shared, and that the old presets are what they were."""

from __future__ import annotations

import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from camera_sim.demo import demo_recording
from camera_sim.sim import conditions as c
from camera_sim.sim.conditions import Conditions, draw_conditions, draw_stated
from camera_sim.sim.stereo import EASY
from camera_sim.sim.surface import FLAT
from camera_sim.sim.view_setting import TUBERS_PER_RECORDING, ViewPlan
from camera_sim.sim.viewpack import pack_views
from camera_sim.sim.views import ViewSimulator

VIEWS_BEFORE = {
    "easy": "3457ba9837f21e4b9e30ee8ec92b13fab016f8b5352492164fea8b6049ed7028",
    "field": "db1efebc6c07f09a99f91926e5afd4a4a92c165a15f2241731982ef23774ed6c",
    "mixed": "8935bf9d5aab84b34e49ca6bcd35dcec83472b4da2cac3590e2ebc8e967b9b25",
}
"""Of all arrays that packs had before recordings had worlds, as they were then."""
ARRAYS_BEFORE = (
    *("depth", "depth_offset", "crop", "depth_scale_m", "intrinsics", "image_size", "belt_distance_m", "belt_sd_m"),
    *("weight_g", "volume_ml", "length_mm", "width_mm", "height_mm", "tuber", "cultivar", "season", "v_centre"),
)
DEMO_BEFORE = "45dff388787a40e8158785ebb8c3611acfbda9f2cf7e1b6717b80800f94518ad"
"""Of the demo's files but its images, and of the images' pixels: how a PNG is packed is the library's affair."""


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
    arrays = pack_views([view for tuber in range(12) for view in simulator.views(tuber)])
    digest = hashlib.sha256()
    for name in ARRAYS_BEFORE:
        digest.update(name.encode() + arrays[name].tobytes())
    assert digest.hexdigest() == VIEWS_BEFORE[preset]


def test_the_demo_recording_is_what_it_was(tmp_path: Path) -> None:
    demo_recording(tmp_path / "demo")
    assert digest_of_recording(tmp_path / "demo") == DEMO_BEFORE


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
