"""A camera's profile: what is measured on simulated recordings is what was simulated; a real camera's is its table."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from camera_sim.sim.optics import BASELINE_M
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.scenes import SceneSettings, build_world, in_its_world, layout_named
from camera_sim.sim.source import simulated_sources
from conveyor.camera_range import CAMERAS, camera_range
from conveyor.depth_noise import disparity, window_residuals_px
from conveyor.errors import InputError
from conveyor.formats import open_source
from conveyor.messages import Frame
from segmenter.frame.noise_watch import NoiseWatch
from segmenter.profile.comb import KNOWN_BASELINES_M, find_comb
from segmenter.profile.holes import islands
from segmenter.profile.profile import CameraProfile, profile_frames
from segmenter.profile.recording import profile_recording
from segmenter.profile.verdict import judge
from tuberline.api.recordings import simulate
from tuberline.cli.camera_profile import profile as profile_command

SHARED = Path(os.environ.get("TUBERLINE_SHARED", "../shared"))
BAG = SHARED / "data" / "realsense_sdk_bag" / "single_depth_color_640x480.bag"
SEED = 9401


def _simulated(preset: str, seed: int, *, frames: int = 5, **noise: Any) -> tuple[SceneSettings, list[Frame]]:
    """A few frames of a belt with five tubers; `noise` changes its camera."""
    layout = layout_named("singulated")
    settings = in_its_world(SceneSettings("singulated", seed, 5, PRESETS[preset]), layout)
    changed = replace(settings.preset, noise=replace(settings.preset.noise, **noise))
    settings = replace(settings, preset=changed)
    source = simulated_sources(build_world(settings, layout), settings, layout)[0]
    numbers = np.linspace(0, (source.description.frames or 1) - 1, frames).astype(int)
    return settings, [source.frame(int(n), run="profile") for n in numbers]


@pytest.fixture(scope="module")
def harsh() -> list[tuple[SceneSettings, CameraProfile]]:
    """Two cameras of the preset 'harsh'; seeds fixed before anything was measured."""
    made = [_simulated("harsh", seed) for seed in (SEED, SEED + 1)]
    return [(settings, profile_frames(frames)) for settings, frames in made]


@pytest.fixture(scope="module")
def easy() -> list[Frame]:
    """A good camera, in the unit in which the D405 measures."""
    layout = layout_named("singulated")
    settings = SceneSettings("singulated", SEED + 2, 5, PRESETS["easy"], unit_m=0.0001)
    source = simulated_sources(build_world(settings, layout), settings, layout)[0]
    return [source.frame(n, run="profile") for n in (40, 60, 80)]


def test_local_noise_is_what_was_simulated(harsh: list[tuple[SceneSettings, CameraProfile]]) -> None:
    for settings, profile in harsh:
        own = settings.conditions
        assert own is not None
        assert own.local_px is not None
        assert profile.noise_px is not None
        assert profile.noise_px[1] == pytest.approx(own.local_px, rel=0.15, abs=0.006), settings.seed
        assert profile.noise_px[0] < profile.noise_px[1] < profile.noise_px[2]


def test_outlines_islands_and_bow_are_what_was_simulated(harsh: list[tuple[SceneSettings, CameraProfile]]) -> None:
    for settings, profile in harsh:
        noise = settings.preset.noise
        assert profile.outline_px is not None
        assert profile.field is not None
        assert profile.field.bow_px is not None
        # The matching window itself takes 2 px or so from each outline.
        assert profile.outline_px[0] == pytest.approx(noise.rim_px + noise.outline_px + 2, rel=0.25), settings.seed
        # Of those that are too far away some become holes, and some lie over others or at outlines.
        few, many = 0.4 * noise.islands - 2.5, 1.3 * noise.islands + 2.5
        assert few < profile.islands_per_megapixel < many, settings.seed
        assert profile.field.bow_px == pytest.approx(noise.bow_px, rel=0.3, abs=0.035), settings.seed


def test_error_of_middle_scale_and_the_belts_relief_add_up(harsh: list[tuple[SceneSettings, CameraProfile]]) -> None:
    for settings, profile in harsh:
        own, noise = settings.conditions, settings.preset.noise
        assert own is not None
        assert own.soil_m is not None
        assert profile.field is not None
        assert profile.plane_m is not None
        soil_px = settings.optics.intrinsics.fx * BASELINE_M / profile.plane_m**2 * own.soil_m
        told = f"seed {settings.seed}: {noise.smooth_px:.3f}, soil {soil_px:.3f}, surface {own.surface.kind}"
        assert 0.75 * noise.smooth_px < profile.field.mid_px < 1.3 * math.hypot(noise.smooth_px, soil_px) + 0.03, told


def test_a_worse_camera_is_outside_and_each_property_says_so(easy: list[Frame]) -> None:
    trained = camera_range(("easy",))
    found = {finding.name: finding for finding in judge(profile_frames(easy), trained)}
    assert not [name for name, finding in found.items() if finding.verdict == "outside"], found
    _, frames = _simulated("easy", SEED + 3, islands=30.0, outline_px=15.0, fine_px=0.06, mid_px=0.05, bow_px=0.12)
    worse = {finding.name: finding for finding in judge(profile_frames(frames), trained)}
    outside = {name for name, finding in worse.items() if finding.verdict == "outside"}
    assert {"local noise", "bow of the field, slower than 40 px", "holes at outlines", "islands of mismatch"} <= outside
    assert all(worse[name].follows for name in outside)
    wide = {f.name: f.verdict for f in judge(profile_frames(frames), camera_range(("easy", "harsh")))}
    assert all(wide[name] == "inside" for name in ("local noise", "holes at outlines", "islands of mismatch")), wide


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A few frames of a good camera, of which those to be changed are rewritten by the test."""
    return simulate(tmp_path / "belt", tubers=1, fps=5.0, speed_mps=1.0, seed=SEED).path


def _change(recording: Path, change: Callable[[int, NDArray[np.uint16]], NDArray[np.uint16]]) -> int:
    files = sorted((recording / "front" / "depth").glob("*.png"))
    for n, file in enumerate(files):
        depth = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        assert cv2.imwrite(str(file), change(n, np.asarray(depth, np.uint16)))
    return len(files)


def test_a_belt_farther_than_those_trained_for_is_outside(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a belt at 1 m it said that weights and intervals hold as stated."""
    far = simulate(tmp_path / "far", tubers=1, fps=5.0, speed_mps=1.0, seed=SEED, belt_distance_m=1.0).path
    profile_command(far)
    said = capsys.readouterr().out
    assert "nothing is outside" not in said
    assert "distance to the belt: every weight is flagged `belt_distance`" in said


def test_a_belt_within_those_trained_for_is_inside(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    profile_command(recording)
    said = capsys.readouterr().out
    row = next(line for line in said.splitlines() if "distance to the belt" in line)
    assert "0.46" in row
    assert "inside" in row


def test_frames_that_cannot_be_used_are_told(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They were left out without a word, and with a depth unit that cannot be nothing that was seen was outside."""
    (recording / "front" / "depth" / "000000.png").write_bytes(b"")
    (recording / "front" / "mask").mkdir()
    profile_command(recording)
    assert "left out: frame 0: " in capsys.readouterr().out
    told = recording / "front" / "camera.json"
    told.write_text(told.read_text().replace('"depth_scale_m": 0.001', '"depth_scale_m": 0.0001'))
    with pytest.raises(InputError, match=r"camera 'front', frame 1: .* should be 0\.001"):
        profile_command(recording)


def test_a_bare_belt_says_what_it_does_not_show(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a tuber in sight nothing is known of outlines; it said that weights and intervals hold as stated."""
    files = sorted((recording / "front" / "depth").glob("*.png"))
    bare = cv2.imread(str(files[0]), cv2.IMREAD_UNCHANGED)
    _change(recording, lambda _n, _depth: np.asarray(bare, np.uint16))
    profile_command(recording)
    said = capsys.readouterr().out
    assert "holes at outlines not seen: too few outlines show: record a loaded belt" in said
    assert "nothing that was seen is outside" in said
    assert "hold as stated" not in said


@pytest.mark.filterwarnings("error")
def test_blank_frames_are_counted_and_not_drawn(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The picture was of the middle frame, with or without depth: NumPy warned of quantiles of nothing."""
    pytest.importorskip("matplotlib")
    frames = _change(recording, lambda n, depth: depth if n == 0 else np.zeros_like(depth))
    picture = recording.parent / "camera.png"
    (camera,) = profile_recording(recording, camera_range(("easy",)))
    assert (camera.profile.frames, camera.profile.blank, camera.first.seq) == (1, frames - 1, 0)
    assert camera.as_dict()["blank_frames"] == frames - 1
    profile_command(recording, out=picture)
    assert picture.stat().st_size > 10_000
    assert f"front: 1 frames, {frames - 1} more without depth: not seen" in capsys.readouterr().out
    _change(recording, lambda _n, depth: np.zeros_like(depth))
    with pytest.raises(InputError, match=rf"belt, camera 'front': none of the {frames} frames looked at has depth"):
        profile_command(recording, out=picture)


@pytest.mark.filterwarnings("error")
def test_a_plane_of_which_only_thin_lines_show_is_not_seen(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its error was the mean of nothing: 'nan px', taken for inside the range, and NaN in the JSON."""
    _change(recording, lambda _n, depth: np.where(np.arange(len(depth))[:, None] % 4, 0, depth).astype(np.uint16))
    profile_command(recording, json=True)

    def no_number(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    (camera,) = json.loads(capsys.readouterr().out, parse_constant=no_number)["cameras"]
    assert camera["plane_m"] is not None
    assert (camera["mid_px"], camera["bow_px"]) == (None, None)
    verdicts = {finding["name"]: finding["verdict"] for finding in camera["findings"]}
    assert verdicts["error of 3 to 40 px and relief"] == "not seen"
    assert verdicts["bow of the field, slower than 40 px"] == "not seen"


def test_an_island_without_surroundings_is_none() -> None:
    """Of a picture no larger than an island the quantiles of nothing were asked for."""
    assert len(islands(np.full((20, 30), 9.0, np.float32)).off_px) == 0


def test_the_step_and_the_baseline_are_found_from_the_depths_alone(easy: list[Frame]) -> None:
    profile = profile_frames(easy)
    assert profile.step is not None
    assert profile.step.steps_per_px == 32
    assert profile.baseline_by == "found"
    assert profile.baseline_m == pytest.approx(BASELINE_M, rel=0.001)


@pytest.mark.parametrize(("model", "steps", "unit_m"), [("D435", 32, 0.001), ("D455", 8, 0.001), ("D405", 16, 0.0001)])
def test_other_cameras_have_other_steps(model: str, steps: int, unit_m: float) -> None:
    """Depths of a comb with known teeth between 0.3 and 1.5 m, at random."""
    rng = np.random.default_rng(SEED)
    strength = 600.0 * KNOWN_BASELINES_M[model]
    teeth = rng.integers(int(strength / 1.5 * steps), int(strength / 0.3 * steps), 200_000)
    counts = np.bincount(np.round(strength * steps / teeth / unit_m).astype(int), minlength=1 << 16)
    found = find_comb(counts, depth_scale_m=unit_m, focal_px=600.0, baselines_m=list(KNOWN_BASELINES_M.values()))
    assert found is not None
    assert found.steps_per_px / found.baseline_m == pytest.approx(steps / KNOWN_BASELINES_M[model], rel=0.002)


def test_depth_without_steps_has_none() -> None:
    counts = np.bincount(np.random.default_rng(SEED).integers(400, 1600, 300_000), minlength=1 << 16)
    assert find_comb(counts, depth_scale_m=0.001, focal_px=600.0, baselines_m=[0.018, 0.05]) is None


def test_residuals_of_a_known_surface_are_its_noise() -> None:
    """A curved surface with white noise: the quadric takes the curve, the rest is the noise, holes or not."""
    rng = np.random.default_rng(SEED)
    v, u = np.mgrid[:240, :320]
    smooth = 20 + 0.01 * u - 0.003 * v + 2e-4 * (u - 160) ** 2
    d = (smooth + 0.05 * rng.standard_normal(smooth.shape)).astype(np.float32)
    assert np.median(window_residuals_px(d)) == pytest.approx(0.05, rel=0.02)
    d[rng.random(d.shape) < 0.3] = 0
    assert np.median(window_residuals_px(d)) == pytest.approx(0.05, rel=0.02)
    d[:] = 0
    assert len(window_residuals_px(d)) == 0


def test_the_watch_measures_what_the_profile_does_at_any_length(easy: list[Frame]) -> None:
    watch, again = NoiseWatch(), NoiseWatch()
    assert watch.noise_px is None
    for frame in easy * 25:
        watch.step(frame)
        again.step(frame)
    assert watch.noise_px is not None
    assert watch.noise_px == again.noise_px
    whole = np.median(
        window_residuals_px(disparity(easy[0].depth, depth_scale_m=0.0001, focal_baseline=433.118 * BASELINE_M))
    )
    assert watch.noise_px == pytest.approx(float(whole), rel=0.12)


def test_shipped_weights_name_worlds_whose_cameras_are_known() -> None:
    """The range stands once: weights name worlds, and the simulator draws `harsh` from the same table."""
    from camera_sim.sim import conditions
    from regressor.network.stored import SHIPPED

    sidecar = json.loads(SHIPPED.with_suffix(".json").read_text(encoding="utf-8"))
    assert sidecar["worlds"]
    assert set(sidecar["worlds"]) <= set(CAMERAS)
    assert CAMERAS["harsh"].local_px is conditions.LOCAL_PX
    assert CAMERAS["harsh"].outline_px is conditions.OUTLINE_PX
    for name in ("easy", "field"):
        assert CAMERAS[name].smooth_px[0] == PRESETS[name].noise.smooth_px
        assert CAMERAS[name].bare[0] == PRESETS[name].noise.bare
        assert CAMERAS[name].steps_per_px == PRESETS[name].noise.steps_per_px


def test_a_real_camera_has_the_step_and_the_noise_that_were_measured_before() -> None:
    """D435, SDK bag: noise .015, .029, .044 px, steps 1/32 px; neighbours .27, .43, 5.7 px apart; 6.7 % without depth.

    Quantiles of another choice of windows, so within a quarter.
    """
    if not BAG.is_file():
        pytest.skip(f"{BAG} is not there: set TUBERLINE_SHARED to the folder that holds data/")
    pytest.importorskip("rosbags")
    frames = [frame for frame in open_source(BAG).frames(run="bag") if isinstance(frame, Frame)]
    profile = profile_frames(frames)
    assert profile.step is not None
    assert profile.step.steps_per_px == 32
    assert profile.baseline_m == pytest.approx(KNOWN_BASELINES_M["D435"], rel=0.01)
    assert profile.noise_px is not None
    assert np.allclose(profile.noise_px, (0.015, 0.029, 0.044), rtol=0.25)
    assert profile.neighbour_px is not None
    assert np.allclose(profile.neighbour_px, (0.27, 0.43, 5.7), rtol=0.25)
    assert profile.missing == pytest.approx(0.067, abs=0.001)
    assert {f.name: f.verdict for f in judge(profile, camera_range(("harsh",)))}["step of disparity"] == "inside"
