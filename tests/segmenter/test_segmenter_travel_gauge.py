"""The belt's travel as a gauge: a camera whose distances contradict it sees tubers at a false size."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from statistics import median

import pytest
from segmenter_scene import MEDIUM, Body, Scene, scattered

from conveyor.belt_findings import belt_findings
from conveyor.camera_flags import SCALED_BY_TRAVEL
from conveyor.config import parse_config
from conveyor.errors import ConfigError
from conveyor.geometry import belt_distance_m
from conveyor.messages import Frame
from regressor.weigh.prepare import prepare_view
from segmenter.gauge.drift import depth_table
from segmenter.outline.correction import CameraCorrection, correction_of, scale_error
from segmenter.outline.watch import OutlineReading
from segmenter.pipeline import ClosedTrack, Segmenter, Settings
from segmenter.setup import core_settings
from tests.regressor.ellipsoids import ellipsoid_view

STEP_M = 0.03
FARTHER, AT_M = 0.025, 0.42


BODIES = [replace(b, place_x_m=2 * b.place_x_m) for b in scattered(15, seed=5)]


def frames(farther: float, *, n: int, bodies: list[Body] = BODIES, told: bool = True) -> Iterable[Frame]:
    """A belt under a camera that was calibrated, and whose disparity then drifted: what lies `AT_M` away, it puts so
    much farther.
    """
    scene = Scene(bodies, MEDIUM, noise_m=0.0003)
    table = depth_table(-CameraCorrection(farther=farther, at_m=AT_M).drift_per_m, depth_scale_m=0.001, finer=10)
    for seq in range(n):
        frame = scene.frame(seq, seq * STEP_M)
        seen = {"depth_scale_m": 0.0001, "depth": table[frame.depth]}
        yield replace(frame, **seen, travel_m=seq * STEP_M if told else None)


def run(taken: Iterable[Frame]) -> tuple[Segmenter, list[ClosedTrack]]:
    core = Segmenter(core_settings(parse_config({"belt": {"gauge": "travel"}}, where="here")))
    closed: list[ClosedTrack] = []
    for frame in taken:
        closed += core.step(frame).closed
    return core, closed


def seen_per_true(closed: Iterable[ClosedTrack]) -> tuple[float, float]:
    """Medians over tubers of length and height, each by that of the body."""
    lengths, heights = [], []
    for track in (one.track for one in closed):
        body = min(BODIES, key=lambda b: abs(b.place_x_m - track.place_x_m) + abs(b.y_m - track.y_m))
        lengths.append(track.length_mm / (2000 * body.a_m))
        heights.append(track.height_mm / (2000 * body.c_m))
    return median(lengths), median(heights)


def test_tubers_are_weighed_at_the_size_that_agrees_with_the_travel() -> None:
    """The belt is seen 13 mm too far away, farther than it is followed: until that is known tubers lie too low."""
    core, closed = run(frames(FARTHER, n=60))
    assert core.outlines is not None
    assert core.outlines.farther == pytest.approx(FARTHER, abs=0.004)
    scaled = [SCALED_BY_TRAVEL in one.track.flags for one in closed]
    assert scaled == sorted(scaled)
    assert not scaled[0]
    before, after = closed[: scaled.index(True)], closed[-6:]
    assert seen_per_true(before)[1] < 0.9
    assert all(SCALED_BY_TRAVEL in one.track.flags for one in after)
    assert seen_per_true(after) == pytest.approx((1.0, 1.0), abs=0.015)
    for view in (view for one in after for view in one.views):
        assert view.depth_scale_m == 0.0001
        assert belt_distance_m(view.belt_from_camera) == pytest.approx(0.46, abs=0.002)
    assert abs(core.belt_check.drift_m or 1.0) < 0.003  # nothing that the camera does not explain
    said = belt_findings("front", core.gauges())["farther_than_travel"]
    assert "the size that agrees with it" in said


def test_without_such_a_gauge_it_is_told_and_left_as_it_is() -> None:
    off = OutlineReading(
        lost_px=0.5, sd_px=0.3, as_seen_px=0.5, mm_per_px=1.0, farther=0.028, farther_sd=0.002, tubers=20,
        slip=0.03, slip_sd=0.002,
    )  # fmt: skip
    assert correction_of(off, focal_px=420.0, by_travel=False).flags == ()
    known = correction_of(off, focal_px=420.0, by_travel=True)
    assert (known.farther, known.at_m) == pytest.approx((0.9 * 0.03, 0.42), abs=0.001)
    assert 0 < scale_error(replace(off, slip_sd=0.01)) < 0.75 * known.farther
    assert known.seen_m(known.true_m(0.5)) == pytest.approx(0.5)
    assert scale_error(replace(off, slip=0.06)) == 0  # no camera: the encoder
    assert correction_of(None, focal_px=420.0, by_travel=True).flags == ()


def test_a_belt_whose_travel_no_encoder_tells_has_no_such_gauge() -> None:
    core, _ = run(frames(FARTHER, n=30, bodies=[], told=False))
    assert "no encoder tells that" in belt_findings("front", core.gauges())["travel_not_told"]
    assert Segmenter(Settings()).gauges().get("travel_not_told") is None


def test_a_view_is_corrected_as_a_whole() -> None:
    """What a camera sees too far away is the same cloud over the same belt again."""
    fine = ellipsoid_view((0.042, 0.033, 0.028))
    camera = CameraCorrection(farther=FARTHER, at_m=0.31)
    drifted = depth_table(-camera.drift_per_m, depth_scale_m=fine.depth_scale_m)[fine.depth]
    pose = fine.belt_from_camera.copy()
    pose[2, 3] = camera.seen_m(pose[2, 3])
    seen = replace(fine, depth=drifted, belt_from_camera=pose)
    true, wrong, again = (prepare_view(view) for view in (fine, seen, camera.corrected(seen)))
    assert again.belt_distance_m == pytest.approx(true.belt_distance_m)
    assert again.height_m == pytest.approx(true.height_m, abs=2e-4)
    assert again.surface.volume_ml == pytest.approx(true.surface.volume_ml, rel=0.004)
    assert wrong.surface.volume_ml > 1.08 * true.surface.volume_ml


def test_a_device_needs_an_encoder_for_it() -> None:
    line = {"belt": {"gauge": "travel"}, "cameras": {"front": {"source": "realsense"}}}
    with pytest.raises(ConfigError, match=r'belt\.gauge is "travel", and nothing tells the travel of camera front'):
        parse_config(line, where="here")
    encoder = {"source": "simulated:?speed_mps=0.4", "metres_per_pulse": 0.0005}
    assert parse_config(line | {"encoder": encoder}, where="here").belt.known_gauge is None
    parse_config(line | {"cameras": {"front": {"path": "recording"}}}, where="here")


def test_a_belt_that_a_drift_may_explain_is_waited_for() -> None:
    """The log said to measure the belt, and seconds later that tubers are weighed at the size that agrees with it."""
    off = {"belt_alarm": 1.0, "belt_drift_mm": -8.5, "belt_tilt_off_deg": 0.1}
    gauge = {"scaled_by_travel": 0.0, "travel_not_told": 0.0}
    assert "wait for it" in belt_findings("front", off | gauge)["belt_alarm"]
    for more in ({}, gauge | {"farther_than_travel": 0.0}, gauge | {"travel_not_told": 1.0}):
        text = belt_findings("front", off | more)["belt_alarm"]
        assert "then give its belt_distance_m or belt_from_camera" in text
        assert "wait" not in text
