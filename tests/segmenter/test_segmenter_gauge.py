"""A gauge tells a mount that moved from a depth scale that drifted, corrects the depth, and says what it was."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.gauge_worlds import Disturbed, GaugeWorld, gauge_world
from conveyor.belt_findings import belt_findings
from conveyor.camera_flags import (
    DEPTH_DRIFT,
    DEPTH_DRIFT_BEYOND,
    MOUNT_MOVED,
    RODS_UNSEEN,
    belt_off_flag,
    belt_off_mm,
)
from conveyor.config import parse_config
from conveyor.errors import ConfigError, InputError
from conveyor.gauge import Gauge, GaugeKind
from conveyor.geometry import belt_distance_m
from conveyor.messages import Frame
from conveyor.resting import RestingLevel
from segmenter.belt_segmenter import Settings
from segmenter.frame.belt_keeper import BeltKeeper
from segmenter.frame.constants import REFUSE_M
from segmenter.frame.plane import BeltCheck
from segmenter.frame.watch import BeltWatch
from segmenter.gauge.drift import depth_table
from segmenter.gauge.estimate import LEAST_LOOKS, REFERENCE_LOOKS, Cause, read
from segmenter.gauge.keeper import GaugeKeeper
from segmenter.gauge.look import GaugeLook
from segmenter.perception import PerceptionSettings
from segmenter.pipeline import Segmenter
from segmenter.setup import core_settings

SEED = 5901
STRENGTH = 433.0 * 0.018
GIVEN_M = 0.46
WIDTH, RODS = Gauge("belt-width", width_m=0.8), Gauge("rods", pitch_m=0.04, rod_m=0.012)


def _looks(*, shift_m: float, drift_px: float, n: int = 40, error: float = 0.0) -> list[GaugeLook]:
    """Looks after a disturbance; `error` is the share by which the gauge's own distance is always wrong."""
    rng = np.random.default_rng(SEED)
    true = GIVEN_M + shift_m + 0.001 * rng.standard_normal(n)
    seen = 1 / (1 / true + (drift_px + 0.01 * rng.standard_normal(n)) / STRENGTH)
    return [GaugeLook(float(s), float(t * (1 + error))) for s, t in zip(seen, true, strict=True)]


@pytest.mark.parametrize(
    ("shift_mm", "drift_px", "cause"),
    [(0.0, 0.0, Cause.NONE), (3.1, 0.0, Cause.MOUNT), (0.0, -0.2, Cause.DRIFT), (-5.0, 0.3, Cause.BOTH)],
)
@pytest.mark.parametrize("gauge", [WIDTH, RODS])
def test_shift_and_drift_are_told_apart(gauge: Gauge, shift_mm: float, drift_px: float, cause: Cause) -> None:
    """A belt's edges that holes have eaten into are as wrong now as they were at first: it changes nothing."""
    error = 0.0 if gauge.absolute else 0.007
    before = _looks(shift_m=0.0, drift_px=0.0, error=error)
    now = _looks(shift_m=shift_mm / 1000, drift_px=drift_px, error=error)
    reading = read(now, before, gauge, given_m=GIVEN_M, strength=STRENGTH)
    assert reading.cause is cause
    assert 1000 * reading.shift_m == pytest.approx(shift_mm, abs=0.7)
    assert reading.drift_px == pytest.approx(drift_px, abs=0.015)
    assert reading.correction_per_m == pytest.approx(drift_px / STRENGTH, abs=0.015 / STRENGTH)


def test_rods_know_a_drift_that_was_there_before_the_run_and_others_do_not() -> None:
    drifted = _looks(shift_m=0.0, drift_px=0.25)
    assert read(drifted, drifted, RODS, given_m=GIVEN_M, strength=STRENGTH).cause is Cause.DRIFT
    assert read(drifted, drifted, WIDTH, given_m=GIVEN_M, strength=STRENGTH).drift_px == pytest.approx(0.0, abs=1e-9)


def test_what_is_too_large_is_told_and_not_corrected() -> None:
    reading = read(
        _looks(shift_m=0.0, drift_px=0.9), _looks(shift_m=0.0, drift_px=0.0), WIDTH, given_m=GIVEN_M, strength=STRENGTH
    )
    assert reading.beyond
    assert reading.correction_per_m == 0.0


def test_the_correction_takes_back_what_a_drift_did() -> None:
    """To half a unit of rounding there and half a unit back, over all depths that a line sees."""
    drift_per_m = 0.4 / STRENGTH
    true = np.arange(2500, 6000)
    drifted = np.round(1 / (1 / (true * 0.0001) + drift_per_m) / 0.0001).astype(np.uint16)
    table = depth_table(drift_per_m, depth_scale_m=0.0001)
    assert np.abs(table[drifted].astype(int) - true).max() <= 1
    assert table[0] == 0
    fine = depth_table(drift_per_m, depth_scale_m=0.001, finer=10)
    millimetres = np.round(1 / (1 / (true * 0.0001) + drift_per_m) / 0.001).astype(np.uint16)
    off = fine[millimetres] - true.astype(float)
    assert abs(off.mean()) < 0.05, "in units of 0.1 mm: what whole millimetres hide is not moved to one side"
    assert np.abs(off).max() <= 0.5 * 10 * 1.16 + 1
    assert np.array_equal(depth_table(0.0, depth_scale_m=0.001)[1:], np.arange(1, 1 << 16))


@pytest.fixture(scope="module", params=["rods", "belt-width", "bar"])
def world(request: pytest.FixtureRequest) -> GaugeWorld:
    """A belt with a gauge under a field camera."""
    kind: GaugeKind = request.param
    return gauge_world(kind, SEED, preset="field", tubers=3)


@pytest.fixture(scope="module")
def reference(world: GaugeWorld) -> GaugeKeeper:
    """The keeper that knows the belt as it was; each test goes on with a copy."""
    return _looked(GaugeKeeper(world.gauge), world, Disturbed(), first=0, looks=REFERENCE_LOOKS)


def _looked(keeper: GaugeKeeper, world: GaugeWorld, by: Disturbed, *, first: int, looks: int) -> GaugeKeeper:
    """After so many looks: each frame is looked at several times, for rendering takes longest."""
    source = world.source(by)
    rendered = [source.frame(first + n, run="gauge") for n in range(_frames(world))]
    for n in range(looks):
        keeper.look(rendered[n % len(rendered)])
    return keeper


def _frames(world: GaugeWorld) -> int:
    return 12 if world.gauge.kind == "bar" else 6


def _keeper(world: GaugeWorld, reference: GaugeKeeper, by: Disturbed) -> GaugeKeeper:
    """It after looks at a belt seen otherwise."""
    frames = _frames(world)
    return _looked(copy.deepcopy(reference), world, by, first=frames, looks=max(LEAST_LOOKS, frames))


def test_a_camera_that_drifts_and_one_that_is_moved_over_a_simulated_belt(
    world: GaugeWorld, reference: GaugeKeeper
) -> None:
    moved = _keeper(world, reference, Disturbed(shift_m=0.004))
    assert moved.reading is not None
    assert moved.reading.cause is Cause.MOUNT, moved.reading
    assert 1000 * moved.reading.shift_m == pytest.approx(4.0, abs=1.5)
    drifted = _keeper(world, reference, Disturbed(drift_px=0.2))
    assert drifted.reading is not None
    assert drifted.reading.cause is Cause.DRIFT, drifted.reading
    assert drifted.reading.drift_px == pytest.approx(0.2, abs=0.04)
    assert drifted.flags() == (DEPTH_DRIFT,)
    assert moved.flags() == (MOUNT_MOVED,)


def test_depth_is_corrected_before_heights_are_taken(world: GaugeWorld, reference: GaugeKeeper) -> None:
    keeper = _keeper(world, reference, Disturbed(drift_px=0.3))
    assert keeper.reading is not None
    right, wrong = (world.source(by).frame(40, run="x") for by in (Disturbed(), Disturbed(drift_px=0.3)))
    mended = keeper.corrected(wrong)
    both = (right.depth > 0) & (wrong.depth > 0)
    off, left = (
        np.median(frame.depth[both] * frame.depth_scale_m - right.depth[both] * right.depth_scale_m)
        for frame in (wrong, mended)
    )
    assert off < -0.0055
    assert abs(left) < 0.0011


def test_a_segmenter_says_why_its_belt_is_off_and_without_a_gauge_only_that_it_is() -> None:
    world = gauge_world("belt-width", SEED, preset="easy", tubers=2)
    source = world.source(Disturbed(drift_px=0.25))
    frames = [frame for frame in source.frames(run="x", after=9) if isinstance(frame, Frame)]
    plain = Settings(perception=PerceptionSettings(method="classical"))
    with_gauge, without = Segmenter(plain), Segmenter(plain)
    known = _looked(GaugeKeeper(world.gauge), world, Disturbed(), first=0, looks=REFERENCE_LOOKS)
    with_gauge.gauge = _keeper(world, known, Disturbed(drift_px=0.25))
    flags: dict[str, set[str]] = {"with": set(), "without": set()}
    for name, segmenter in (("with", with_gauge), ("without", without)):
        closed = [track for frame in frames for track in segmenter.step(frame).closed] + segmenter.finish()
        assert closed, name
        flags[name] |= {flag for track in closed for flag in track.track.flags}
    assert flags["with"] == {DEPTH_DRIFT}
    assert [belt_off_mm(flags["without"])] == [pytest.approx(6, abs=1)], flags
    assert with_gauge.belt is not None
    assert belt_distance_m(with_gauge.belt.belt_from_camera) == pytest.approx(GIVEN_M, abs=0.0012)
    text = belt_findings("front", with_gauge.gauge.gauges())["gauge_drift"]
    assert "the depth scale drifted by +0.2" in text
    assert "corrected" in text


def test_no_gauge_and_no_calibrated_belt_change_nothing() -> None:
    world = gauge_world("rods", SEED, preset="easy", tubers=2)
    frame = world.source(Disturbed()).frame(3, run="x")
    assert GaugeKeeper(None).corrected(frame) is frame
    loose = GaugeKeeper(world.gauge)
    for _ in range(3):
        loose.look(replace(frame, belt_distance_m=None))
    assert loose.reading is None
    assert loose.gauges() == {}
    assert loose.flags() == ()
    for _ in range(REFERENCE_LOOKS):
        loose.look(replace(frame, belt_distance_m=None))
    assert "has not been seen once" in belt_findings("front", loose.gauges())["gauge_unseen"]
    assert loose.flags() == (RODS_UNSEEN,), "the load's interval takes them for no gauge"
    loose.look(frame)
    assert belt_findings("front", loose.gauges()) == {}, "it came into view"
    assert loose.flags() == ()


def test_a_web_is_checked_by_its_rods_and_the_ground_between_is_no_belt() -> None:
    """With the ground 92 mm below, a camera that was moved by 5 mm ended its run: "the belt lies at 0.552 m"."""
    world = gauge_world("rods", SEED, preset="easy", tubers=2)
    web = RestingLevel(surface="rods", rod_pitch_m=world.gauge.pitch_m, rod_diameter_m=world.gauge.rod_m)
    frames = [world.source(Disturbed(shift_m=shift_m)).frame(3, run="x") for shift_m in (0.0, 0.005)]
    seen_m = []
    for frame in frames:
        keeper = BeltKeeper(0.006, web=web)
        belt = keeper.belt_of(frame)
        assert belt is not None
        assert belt_distance_m(belt.belt_from_camera) == pytest.approx(GIVEN_M, abs=1e-9), "a web is not followed"
        assert keeper.check.drift_m is not None
        seen_m.append(keeper.check.drift_m)
    assert abs(seen_m[0]) < 0.004, "the belt shakes by 3 mm at most"
    assert seen_m[1] - seen_m[0] == pytest.approx(0.005, abs=0.001)
    watch = BeltWatch()
    for check in (BeltCheck(None, 0.001), BeltCheck(None, 0.0082)):
        watch.step(check, None, travel_m=0.0, told=False)
    assert watch.gauges()["belt_alarm"] == 0.0
    wrong = BeltKeeper(web=web)
    assert wrong.belt_of(replace(frames[0], belt_distance_m=0.40, belt_from_camera=None)) is None
    with pytest.raises(InputError, match=r"calibrated for a belt at 0\.400 m"):
        wrong.finish()
    with pytest.raises(InputError, match="from the camera to the rods' tops"):
        BeltKeeper(web=web).belt_of(replace(frames[0], belt_distance_m=None, belt_from_camera=None))


def test_findings_name_the_cause() -> None:
    levels = {"gauge_cause": 1.0, "gauge_shift_mm": 3.14, "gauge_drift_px": 0.0, "gauge_beyond": 0.0}
    assert "the mount moved by 3.1 mm, away from the belt; corrected" in belt_findings("front", levels)["gauge_mount"]
    beyond = belt_findings("front", {"gauge_cause": 2.0, "gauge_drift_px": -0.72, "gauge_beyond": 1.0})["gauge_drift"]
    assert "drifted by -0.72 px of disparity: more than is corrected" in beyond
    assert belt_findings("front", {"gauge_cause": 0.0}) == {}


def test_a_belts_offset_without_a_cause_is_told_in_whole_millimetres() -> None:
    assert belt_off_flag(0.0024) == ()
    assert belt_off_flag(-0.0041) == ("belt_off_4mm",)
    assert belt_off_flag(REFUSE_M) == ("belt_off_20mm",), "as far as a belt is taken: from 16 mm on loads looked surer"
    assert belt_off_flag(0.040) == (), "that is the ground"
    assert belt_off_mm(("cut", "belt_off_4mm")) == 4
    assert belt_off_mm(("belt_off_mm", "belt_off_xmm", DEPTH_DRIFT_BEYOND)) == 0


def test_the_lines_file_describes_a_gauge_or_is_refused() -> None:
    config = parse_config(
        {"belt": {"gauge": "bar", "gauge_size_mm": [300, 60], "gauge_place_mm": [0, -240, 120]}}, where="test"
    )
    assert core_settings(config).gauge == Gauge(
        "bar", pitch_m=0.04, rod_m=0.011, size_m=(0.3, 0.06), place_m=(0.0, -0.24, 0.12)
    )
    assert core_settings(parse_config({}, where="test")).gauge is None
    for belt, says in (
        ({"gauge": "rods"}, 'surface = "rods"'),
        ({"gauge": "belt-width"}, "gauge_width_m"),
        ({"gauge": "bar"}, "gauge_size_mm"),
        ({"gauge": "bar", "gauge_size_mm": [300, 60], "gauge_place_mm": [0, 0, 10]}, "40 mm at least"),
        ({"gauge_width_m": 0.6}, 'gauge_width_m given without gauge: set gauge = "belt-width", or "none"'),
        ({"rod_pitch_mm": 32}, 'rod_pitch_mm given without surface: set surface = "rods", or "flat"'),
    ):
        with pytest.raises(ConfigError, match=says):
            parse_config({"belt": belt}, where="test")
