"""The belt watched: a wrong distance, a wrong tilt and a belt that runs the other way are said once, with the fix."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from segmenter_scene import SMALL, Body, Scene, scattered, tilted

from conveyor.belt_findings import belt_findings, found_so_far
from conveyor.camera_place import CameraPlace
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages import Frame
from segmenter.frame.plane import check_belt, fit_plane
from segmenter.frame.watch import BeltWatch
from segmenter.pipeline import Segmenter, Settings

STEP_M = 0.0133


def watched(frames: Iterable[Frame]) -> tuple[Segmenter, dict[str, float]]:
    core, watch = Segmenter(Settings()), BeltWatch()
    for frame in frames:
        core.step(frame)
        watch.step(core.belt_check, core.instances, travel_m=core.travel_m, told=core.told)
    return core, watch.gauges()


SCENE = Scene(scattered(15, seed=3), SMALL, noise_m=0.001)


@functools.cache
def seen(number: int, *, tubers: int = 15, seed: int = 3) -> Frame:
    """Of a belt that runs as its encoder says; many tests look at the same frames."""
    scene = Scene(scattered(tubers, seed=seed), SMALL, noise_m=0.001)
    return scene.frame(number, number * STEP_M)


def test_a_calibrated_belt_raises_nothing() -> None:
    for encoder in (True, False):
        _, levels = watched(seen(i) if encoder else replace(seen(i), travel_m=None) for i in range(40))
        assert belt_findings("front", levels) == {}
        assert abs(levels["belt_drift_mm"]) < 1
        assert levels["belt_tilt_off_deg"] < 0.3


def test_what_a_few_tubers_said_of_outlines_is_taken_back_and_a_belt_that_was_off_is_not() -> None:
    early = belt_findings("front", {"belt_alarm": 1.0, "belt_drift_mm": 15.0, "outline_grown_px": 1.7})
    assert list(early) == ["belt_alarm", "outline_grown_px"]
    so_far = found_so_far(early, belt_findings("front", {"outline_grown_px": 2.1}))
    assert list(so_far) == ["belt_alarm", "outline_grown_px"]
    assert "2.1 px" in so_far["outline_grown_px"]
    assert list(found_so_far(so_far, belt_findings("front", {}))) == ["belt_alarm"]


@pytest.mark.parametrize(("given_m", "drift_mm", "word"), [(0.475, -15, "nearer"), (0.445, 15, "farther")])
def test_a_belt_distance_wrong_by_15_mm_is_said_with_the_number(given_m: float, drift_mm: float, word: str) -> None:
    wrong = straight_down_belt_from_camera(given_m)
    _, levels = watched(replace(seen(i), belt_from_camera=wrong) for i in range(35))
    assert levels["belt_alarm"] == 1
    assert levels["belt_drift_mm"] == pytest.approx(drift_mm, abs=1)
    text = belt_findings("front", levels)["belt_alarm"]
    assert f"'front': the belt is seen {abs(levels['belt_drift_mm']):.1f} mm {word} than" in text


def test_a_tilt_wrong_by_2_degrees_is_said_though_the_distance_is_right() -> None:
    wrong = tilted(0.46, 2)
    _, levels = watched(replace(seen(i), belt_from_camera=wrong) for i in range(35))
    assert levels["belt_alarm"] == 1
    assert abs(levels["belt_drift_mm"]) < 3
    assert levels["belt_tilt_off_deg"] == pytest.approx(2, abs=0.3)
    leaning = f"{levels['belt_tilt_off_deg']:.1f} degrees"
    assert belt_findings("front", levels)["belt_alarm"].startswith(
        f"camera 'front': the belt is seen to lean {leaning} against its calibration: counts and weights are off."
    )


@pytest.mark.parametrize(
    ("drift_mm", "tilt_deg", "said", "fix"),
    [
        (9.04, 0.3, "the belt is seen 9.0 mm farther than its calibration says:", "its belt_distance_m or belt_from"),
        (-9.0, 0.0, "the belt is seen 9.0 mm nearer than its calibration says:", "its belt_distance_m or belt_from"),
        (0.02, 20.0, "the belt is seen to lean 20.0 degrees against its calibration:", "its belt_from_camera"),
        (-5.9, 1.1, "the belt is seen to lean 1.1 degrees against its calibration:", "its belt_from_camera"),
        (
            7.0,
            2.0,
            "7.0 mm farther than its calibration says, and leans 2.0 degrees against it:",
            "its belt_from_camera",
        ),
    ],
)
def test_of_a_belt_only_what_is_off_is_said(drift_mm: float, tilt_deg: float, said: str, fix: str) -> None:
    """A belt whose distance was right was "seen 0.0 mm farther ... and leans 20.0 degrees against it"."""
    levels = {"belt_alarm": 1.0, "belt_drift_mm": drift_mm, "belt_tilt_off_deg": tilt_deg}
    text = belt_findings("front", levels)["belt_alarm"]
    assert f"{said} counts and weights are off. Measure the belt" in text
    assert f"then give {fix}" in text


def test_a_distance_25_mm_off_with_load_at_the_given_height_is_no_silence() -> None:
    """It was refused only where nothing lay at the height given, and else nothing was said at all."""
    depth, _ = SCENE.render(0.2)
    fit = fit_plane(depth, depth_scale_m=0.001, intrinsics=SMALL)
    given = straight_down_belt_from_camera(0.435)
    check = check_belt(given, fit, given_share=0.1, camera="front", depth_scale_m=0.001)
    assert check.alarm
    assert check.drift_m == pytest.approx(0.025, abs=0.001)


@pytest.mark.parametrize("encoder", [True, False])
def test_a_belt_that_runs_the_other_way_is_said_and_counts_once_corrected(encoder: bool) -> None:
    bodies = scattered(15, seed=3)
    turned = straight_down_belt_from_camera(0.46)
    turned[:2] *= -1
    true = Scene(bodies, SMALL, turned, noise_m=0.001)
    frames = [true.frame(i, i * STEP_M, encoder=encoder) for i in range(70)]
    core, levels = watched(replace(frame, belt_from_camera=straight_down_belt_from_camera(0.46)) for frame in frames)
    assert core.counted == 0
    assert levels["belt_backwards"] == 1
    assert "negate its first two rows" in belt_findings("front", levels)["belt_backwards"]
    corrected, levels = watched(frames)
    corrected.finish()
    assert levels["belt_backwards"] == 0
    assert corrected.counted == len(bodies)


@pytest.mark.parametrize("encoder", [True, False])
@pytest.mark.parametrize("turned_deg", [7.0, -12.0, 25.0])
def test_a_camera_that_is_turned_against_its_pose_is_said(encoder: bool, turned_deg: float) -> None:
    """From 10 degrees on half of the tubers were counted twice, and nothing was said."""
    said = CameraPlace(turned_deg=turned_deg).straight_down(0.46)
    frames = (replace(seen(i, tubers=30), belt_from_camera=said) for i in range(60))
    _, levels = watched(frame if encoder else replace(frame, travel_m=None) for frame in frames)
    assert levels["belt_turned"] == 1
    assert levels["belt_turned_deg"] == pytest.approx(turned_deg, abs=0.7)
    assert (levels["belt_backwards"], levels["encoder_off"]) == (0, 0)
    text = belt_findings("front", levels)["belt_turned"]
    assert f"the load moves {levels['belt_turned_deg']:+.1f} degrees aside" in text


def test_a_camera_that_is_turned_by_a_quarter_unsaid_is_no_belt_that_runs_the_other_way() -> None:
    """Tubers in even rows let the travel be anything, -13 m of 1.5; `turned_deg = 180` was said to put it right, with
    which nothing was counted either.
    """
    true = Scene(scattered(30, seed=3), SMALL, CameraPlace(turned_deg=90.0).straight_down(0.46), noise_m=0.001)
    core, watch = Segmenter(Settings()), BeltWatch()
    for i in range(40):
        frame = true.frame(i, i * STEP_M, encoder=False)
        core.step(replace(frame, belt_from_camera=straight_down_belt_from_camera(0.46)))
        watch.step(core.belt_check, core.instances, travel_m=-0.09 * i, told=False)
    levels = watch.gauges()
    assert belt_findings("front", levels).keys() == {"belt_turned"}
    assert levels["belt_turned_deg"] == pytest.approx(-90.0, abs=0.7)


@pytest.mark.parametrize("turned_deg", [0.0, 3.5, -3.5])
def test_a_camera_that_is_turned_as_hands_turn_it_counts_and_is_no_finding(turned_deg: float) -> None:
    said = CameraPlace(turned_deg=turned_deg).straight_down(0.46)
    core, levels = watched(replace(seen(i, tubers=30, seed=4), belt_from_camera=said) for i in range(140))
    core.finish()
    assert belt_findings("front", levels) == {}
    assert levels["belt_turned_deg"] == pytest.approx(turned_deg, abs=0.7)
    assert core.counted == 30


def test_a_belt_that_runs_the_other_way_from_bare_to_loaded_has_no_negative_metres() -> None:
    """Before the load told its speed, belt passed unseen: told backwards, it ended the process with each mark."""
    frames = (SCENE.frame(i, 0.9 - i * STEP_M, encoder=False) for i in range(70))
    core, levels = watched(frames)
    assert core.travel_m < -0.4
    assert levels["belt_backwards"] == 1
    assert (core.looked_at_m, core.travelled_m) == (0.0, 0.0)
    assert "turned_deg = 180" in belt_findings("front", levels)["belt_backwards"]


def test_a_belt_that_backs_up_a_little_is_no_finding() -> None:
    travels = np.cumsum([0.0] + [STEP_M] * 20 + [-0.005] * 20 + [STEP_M] * 20)
    _, levels = watched(SCENE.frame(i, float(t)) for i, t in enumerate(travels))
    assert levels["belt_backwards"] == 0


@pytest.mark.parametrize("share", [0.0, 0.5, 0.8, 1.25, 3.28, 100.0, 1000.0])
def test_an_encoder_that_tells_another_travel_is_said_with_both_numbers(share: float) -> None:
    """One that stood still lost all tubers, one in millimetres counted each sixteen times, and nothing was said."""
    _, levels = watched(replace(seen(i), travel_m=share * i * STEP_M) for i in range(40))
    assert levels["encoder_off"] == 1
    assert levels["encoder_told_m"] == pytest.approx(share * levels["encoder_seen_m"], rel=0.02)
    text = belt_findings("front", levels)["encoder_off"]
    assert f"moved {levels['encoder_seen_m']:.2f} m while the encoder told {levels['encoder_told_m']:.2f} m" in text


@pytest.mark.parametrize("share", [0.95, 1.0, 1.05])
def test_an_encoder_that_is_off_by_less_than_a_count_shows_is_no_finding(share: float) -> None:
    _, levels = watched(replace(seen(i), travel_m=share * i * STEP_M) for i in range(40))
    assert levels["encoder_off"] == 0


@pytest.mark.parametrize(("coarse_mm", "told"), [(20, False), (50, True), (90, True)])
def test_travel_that_is_told_in_coarse_steps_is_said_with_the_step(coarse_mm: int, told: bool) -> None:
    """Rounded to 50 mm, 27 of 24 tubers were counted, and nothing was said."""
    coarse_m = coarse_mm / 1000
    travels = (round(i * STEP_M / coarse_m) * coarse_m for i in range(60))
    _, levels = watched(replace(seen(i), travel_m=told_m) for i, told_m in enumerate(travels))
    found = belt_findings("front", levels)
    assert list(found) == ["encoder_coarse_m"] * told
    assert not told or f"travel is told in steps of {coarse_mm} mm" in found["encoder_coarse_m"]


def test_a_fast_belt_that_runs_the_other_way_is_said_too() -> None:
    """Of steps longer than 30 mm nothing was said."""
    frames = (SCENE.frame(i, 0.6 - i * 0.04) for i in range(28))
    _, levels = watched(replace(frame, travel_m=0.04 * frame.seq) for frame in frames)
    assert levels["belt_backwards"] == 1
    assert levels["encoder_off"] == 0


def test_a_belt_that_runs_the_other_way_is_said_where_one_tuber_lies_at_a_time() -> None:
    lone = Scene([Body(-0.1 - 0.5 * n, 0.03 * (-1) ** n) for n in range(6)], noise_m=0.001)
    frames = (replace(lone.frame(i, 2.0 - i * STEP_M), travel_m=i * STEP_M) for i in range(70))
    _, levels = watched(frames)
    assert levels["belt_backwards"] == 1


def test_the_load_stands_when_the_encoder_stands() -> None:
    travels = np.cumsum([0.0] + [STEP_M] * 15 + [0.0] * 15 + [STEP_M / 3] * 15)
    _, levels = watched(SCENE.frame(i, float(t)) for i, t in enumerate(travels))
    assert belt_findings("front", levels) == {}
