"""`tuberline doctor` on the belt's distance: measured in frames, told by segmenters, against what is configured."""

from __future__ import annotations

from pathlib import Path

import pytest

from conveyor.camera_range import camera_range
from conveyor.config import parse_config
from conveyor.messages import Counters
from tuberline.cli.simulate import simulate
from tuberline.doctor import Level
from tuberline.doctor.belt import check_belt_seen, check_running_belts
from tuberline.doctor.depth import check_running_noise
from tuberline.doctor.examine import examine
from tuberline.doctor.places import check_agreement, check_exchanged, check_places


@pytest.mark.parametrize(
    ("given_m", "seen_m", "level", "says"),
    [
        (0.460, [0.4605, 0.4598, 0.4601], Level.OK, "seen at 0.4601 m in 3 of 5 frames, given 0.4600 m: +0.1 mm"),
        (0.460, [0.452, 0.452, 0.452], Level.WARNING, "-8.0 mm"),
        (0.460, [0.345, 0.345, 0.346], Level.FAULT, "given 0.4600 m: -115.0 mm"),
        (0.460, [4.60, 4.61], Level.FAULT, "seen at 4.6050 m"),
        (None, [0.345, 0.345], Level.WARNING, "no distance is given: each start fits it again"),
        (0.460, [0.46], Level.WARNING, "too little belt shows in 5 frames"),
    ],
)
def test_a_belt_is_compared_with_its_calibration(
    given_m: float | None, seen_m: list[float], level: Level, says: str
) -> None:
    found = check_belt_seen("left", given_m=given_m, seen_m=seen_m, frames=5)
    assert found.level is level
    assert says in found.text


def test_the_mend_can_be_pasted() -> None:
    off = check_belt_seen("left", given_m=0.46, seen_m=[0.4812, 0.4812], frames=5)
    assert "set cameras.left.belt_distance_m = 0.4812" in off.fix
    assert "tuberline calibrate belt" in off.fix
    scale = check_belt_seen("left", given_m=0.46, seen_m=[4.6, 4.6], frames=5)
    assert scale.fix == "the depth scale is wrong: correct cameras.left.depth_scale_m"


def test_a_belt_that_a_drift_may_explain_is_left_as_it_is() -> None:
    """With `gauge = "travel"` it was to be given the distance at which a drifted camera sees it."""
    off = check_belt_seen("left", given_m=0.46, seen_m=[0.4512, 0.4512], frames=5, by_travel=True)
    assert (off.level, off.text) == (Level.WARNING, "seen at 0.4512 m in 2 of 5 frames, given 0.4600 m: -8.8 mm")
    assert "leave it as it is" in off.fix
    assert "belt_distance_m" not in off.fix


def test_what_the_gauge_travel_does_is_told_and_what_to_do() -> None:
    """Below 2 % it was told nowhere; from there on the fix was that of a line without such a gauge."""
    config = parse_config({"cameras": {"left": {}}}, where="test")

    def found(**gauges: float) -> list[tuple[str, Level, str, str]]:
        nodes = {"segmenter/left": Counters("segmenter", "left", "r", 1, "h", "1", 9.0, {}, gauges)}
        return [(f.check, f.level, f.text, f.fix) for f in check_running_belts(config, nodes, alive=set(nodes))]

    scaled = ("gauge of left", Level.OK, "tubers are weighed +1.4 % in size, as the belt's travel says", "")
    assert found(scaled_by_travel=-0.014, farther_than_travel=0.0) == [scaled]
    told, of_gauge = found(scaled_by_travel=-0.022, farther_than_travel=-0.024)
    assert (told[:2], of_gauge[2]) == (("tubers of left", Level.WARNING), scaled[2].replace("1.4", "2.2"))
    assert "calibrate the camera's depth" in told[3]
    (waits,) = found(scaled_by_travel=0.0, belt_alarm=1.0, belt_drift_mm=-8.5)
    assert waits[3].startswith("wait until some tubers have passed")


def test_a_running_segmenter_is_believed() -> None:
    config = parse_config({"cameras": {"left": {}, "right": {}, "new": {}, "leaning": {}}}, where="test")
    nodes = {
        f"segmenter/{name}": Counters("segmenter", name, "r", 1, "h", "1", 9.0, {}, gauges)
        for name, gauges in {
            "left": {"belt_drift_mm": -0.2, "belt_alarm": 0.0},
            "right": {"belt_drift_mm": 11.0, "belt_tilt_off_deg": 1.5, "belt_alarm": 1.0},
            "new": {},
            "leaning": {"belt_drift_mm": 0.02, "belt_tilt_off_deg": 20.0, "belt_alarm": 1.0},
        }.items()
    }
    found = {f.check: f for f in check_running_belts(config, nodes, alive=set(nodes))}
    assert {name.removeprefix("belt of "): f.level for name, f in found.items()} == {
        "leaning": Level.FAULT,
        "left": Level.OK,
        "right": Level.FAULT,
    }
    assert found["belt of right"].text == "segmenter/right sees it +11.0 mm off its calibration, leaning 1.5 deg"
    assert found["belt of leaning"].text == "segmenter/leaning sees it leaning 20.0 deg against its calibration"
    assert check_running_belts(config, nodes, alive=set()) == []


@pytest.mark.parametrize(
    ("level", "more", "said"),
    [
        ("belt_backwards", {}, "the belt runs against the direction"),
        ("belt_turned", {"belt_turned_deg": 11.0}, "the load moves +11.0 degrees aside"),
        ("encoder_off", {"encoder_told_m": 1.0, "encoder_seen_m": 2.0}, "the load moved 2.00 m while the encoder told"),
        ("load_torn_m", {}, "the load jumped back 1.00 m"),
        ("encoder_coarse_m", {"encoder_coarse_m": 0.05}, "travel is told in steps of 50 mm"),
        ("masks_merged", {}, "a label of the given masks lies in several places apart"),
        ("like_clods", {"like_clods": 0.85}, "85 % of the last bodies look like clods"),
    ],
)
def test_a_load_that_moves_another_way_is_a_fault(level: str, more: dict[str, float], said: str) -> None:
    config = parse_config({"cameras": {"left": {}}}, where="test")
    gauges = {"belt_drift_mm": 0.1, level: 1.0, **more}
    nodes = {"segmenter/left": Counters("segmenter", "left", "r", 1, "h", "1", 9.0, {}, gauges)}
    other, belt = check_running_belts(config, nodes, alive=set(nodes))
    assert (other.level, belt.level) == (Level.FAULT, Level.OK)
    assert said in other.text
    del gauges["belt_drift_mm"]
    assert check_running_belts(config, nodes, alive=set(nodes)) == [other], "a load hid the belt, and nothing was said"


def test_outlines_that_grow_and_distances_that_contradict_the_travel_are_told() -> None:
    config = parse_config({"cameras": {"left": {}}}, where="test")
    gauges = {"belt_drift_mm": 0.1, "outline_grown_px": 3.2, "farther_than_travel": -0.024, "outline_lost_px": -3.2}
    gauges["without_depth"] = 0.48
    nodes = {"segmenter/left": Counters("segmenter", "left", "r", 1, "h", "1", 9.0, {}, gauges)}
    dark, grown, farther, belt = check_running_belts(config, nodes, alive=set(nodes))
    assert (dark.level, grown.level, farther.level, belt.level) == (*3 * (Level.WARNING,), Level.OK)
    assert "48 % of its picture shows no depth" in dark.text
    assert "outlines are 3.2 px larger" in grown.text
    assert "it puts tubers 2.4 % nearer" in farther.text


def test_a_running_segmenters_gauge_and_noise_are_told() -> None:
    config = parse_config({"cameras": {"left": {}, "right": {}, "third": {}, "far": {}}}, where="test")
    nodes = {
        f"segmenter/{name}": Counters("segmenter", name, "r", 1, "h", "1", 9.0, {}, {"belt_drift_mm": 0.3, **gauges})
        for name, gauges in {
            "third": {"gauge_unseen": 1.0},
            "left": {"gauge_cause": 2.0, "gauge_drift_px": 0.21, "camera_noise_px": 0.02},
            "right": {"gauge_cause": 0.0, "camera_noise_px": 0.2},
            "far": {"gauge_cause": 2.0, "gauge_drift_px": 0.9, "gauge_beyond": 1.0},
        }.items()
    }
    found = {f.check: f for f in check_running_belts(config, nodes, alive=set(nodes))}
    assert found["gauge of left"].level is Level.WARNING
    assert "the depth scale drifted by +0.21 px" in found["gauge of left"].text
    assert "gauge of right" not in found
    assert found["gauge of far"].level is Level.FAULT, "weights are off, it says"
    assert "has not been seen once" in found["gauge of third"].text
    assert "correct the gauge in [belt]" in found["gauge of third"].fix
    noisy = check_running_noise(config, nodes, camera_range(("easy",)), alive=set(nodes))
    assert [(f.check, f.level) for f in noisy] == [("depth of right", Level.WARNING)]
    assert "measures 0.200 px of noise" in noisy[0].text


def test_the_places_of_cameras_are_compared() -> None:
    live = {"source": "realsense", "belt_distance_m": 0.46}
    (found,) = check_places(parse_config({"cameras": {"left": live, "right": live}}, where="test"))
    assert found.level is Level.WARNING
    assert "cameras left, right are taken to hang at one place" in found.text
    hung = {"left": {**live, "across_m": -0.3}, "right": {**live, "across_m": 0.3}}
    assert check_places(parse_config({"cameras": hung}, where="test")) == []
    apart = {"first": "left", "second": "right", "along_mm": -2.0, "across_mm": 41.0, "shared": 20, "twice": 0}
    told = [
        check_agreement({"apart": [{**apart, "twice": twice, "alarm": alarm}]})[0]
        for twice, alarm in ((7, True), (0, True), (0, False), (1, False))
    ]
    assert [finding.level for finding in told] == [Level.FAULT, Level.WARNING, Level.OK, Level.OK]
    assert told[0].text == "the same tubers -2 mm along the belt, +41 mm across: 7 of 20 counted twice"
    assert "calibrate cameras" in told[0].fix
    assert check_agreement(None) == check_exchanged(None) == []
    change = {"camera": "left", "before": "serial 77", "now": "serial 78", "since_ns": 1}
    (found,) = check_exchanged({"exchanged": [change]})
    assert (found.check, found.level) == ("device of left", Level.WARNING)
    assert found.text.startswith("camera left was exchanged or is set otherwise: it was serial 77, it is serial 78. ")


def test_doctor_measures_a_recordings_belt(tmp_path: Path) -> None:
    simulate(out=tmp_path / "belt", seed=3, scene="singulated", tubers=2, fps=5.0, camera="d405-848")
    (name,) = [file.parent.name for file in (tmp_path / "belt").glob("*/camera.json")]
    raw = {"cameras": {name: {"path": str(tmp_path / "belt")}}, "aggregator": {"out": str(tmp_path)}}
    right = {f.check: f for f in examine(parse_config(raw, where="test"), offline=True)}
    assert right[f"belt of {name}"].level is Level.OK
    assert right[f"depth of {name}"].level is Level.OK, right[f"depth of {name}"]
    raw["cameras"][name]["belt_distance_m"] = 0.445  # type: ignore[index]
    moved = {f.check: f for f in examine(parse_config(raw, where="test"), offline=True)}
    assert moved[f"belt of {name}"].level is Level.WARNING
    assert "given 0.4450 m: +1" in moved[f"belt of {name}"].text
