"""What the operator's page says of one camera's belt, encoder and gauge, and of what its tubers say of it."""

from __future__ import annotations

import pytest

from tests.viewer.page_states import good_state, node, segmenter, with_node
from tests.viewer.test_viewer_page_alarms import texts
from viewer.page.alarms import alarms


@pytest.mark.parametrize(
    ("gauges", "said"),
    [
        ({"belt_backwards": 1.0}, "Under camera left the belt runs the other way than its pose or the encoder says"),
        ({"belt_turned": 1.0, "belt_turned_deg": -11.8}, "the load moves 12° aside of the way its pose says"),
        (
            {"encoder_off": 1.0, "encoder_told_m": 1.14, "encoder_seen_m": 2.27},
            "the load moved 2.27 m while the encoder told 1.14 m",
        ),
        ({"load_torn_m": 0.37}, "Under camera left the load jumped back 0.37 m, as no belt does"),
        ({"encoder_coarse_m": 0.05}, "Camera left is told the belt's travel in steps of 50 mm"),
        ({"masks_merged": 3.0}, "The masks of camera left give several tubers one label"),
        ({"without_depth": 0.48}, "Camera left shows no depth in 48 % of its picture"),
        ({"like_clods": 0.85}, "Under camera left 85 % of the bodies look like clods, too many to believe"),
    ],
)
def test_a_load_that_moves_otherwise_than_pose_or_encoder_say(gauges: dict[str, float], said: str) -> None:
    """Only the segmenter's log said so."""
    (text,) = texts(with_node(good_state(), "segmenter/left", segmenter("left", gauges=gauges)), "trouble")
    assert said in text


@pytest.mark.parametrize(
    ("gauges", "said"),
    [
        ({"encoder_coarse_m": 0.034}, "in steps of 34 mm: from 40 mm on tubers count twice."),
        ({"picture_stood": 12.0}, "Camera left gave the same picture for 12 frames"),
        ({"without_depth": 0.28}, "Camera left shows no depth in 28 % of its picture"),
        ({"outline_grown_px": 3.24}, "Camera left draws tubers 3.2 px larger all round than they are."),
        ({"farther_than_travel": 0.024}, "Camera left puts tubers 2.4 % farther away than the belt's travel says"),
        ({"farther_than_travel": -0.024}, "Camera left puts tubers 2.4 % nearer than the belt's travel says"),
        (
            {"farther_than_travel": -0.024, "scaled_by_travel": -0.022},
            "left measures distances 2.4 % off what the belt's travel says. Weights are corrected",
        ),
        ({"travel_not_told": 1.0}, "Camera left is to be checked against the belt's travel, but no encoder tells it."),
    ],
)
def test_what_tubers_say_of_their_camera_is_a_warning(gauges: dict[str, float], said: str) -> None:
    """Only the log, doctor and replay said so."""
    (text,) = texts(with_node(good_state(), "segmenter/left", segmenter("left", gauges=gauges)), "warning")
    assert said in text


def test_a_belt_that_a_drift_may_explain_is_waited_for() -> None:
    """The page said to measure the distance, and a minute later that weights are corrected."""
    off = {"belt_alarm": 1.0, "belt_drift_mm": -8.5, "scaled_by_travel": 0.0}
    told = {"farther_than_travel": 0.0}
    for gauges, fix in ((off, "Wait until some tubers have passed"), (off | told, "measure the distance again")):
        state = with_node(good_state(), "segmenter/left", segmenter("left", gauges=gauges))
        (alarm,) = (alarm for alarm in alarms(state) if alarm.level == "trouble")
        assert (alarm.text, fix in alarm.fix, "Wait" in alarm.fix) == (
            "Under camera left the belt is 8 mm nearer than calibrated: weights are wrong.",
            True,
            gauges is off,
        )


def test_an_encoder_that_is_not_heard_or_not_believed() -> None:
    state = with_node(good_state(), "camera/left", node("camera/left", gauges={"encoder_silent_s": 12.0}))
    (text,) = texts(state, "warning")
    assert "Camera left has heard nothing from the encoder for 12 s" in text
    behind = with_node(good_state(), "segmenter/left", segmenter("left", gauges={"encoder_behind_m": 1.04}))
    (text,) = texts(behind, "warning")
    assert "Under camera left the encoder came back 1.04 m behind where the load had gone" in text
    brief = with_node(good_state(), "camera/left", node("camera/left", gauges={"encoder_silent_s": 1.0}))
    assert not texts(brief, "warning")


@pytest.mark.parametrize(("drift_mm", "said"), [(14.2, "14 mm further than"), (-7.0, "7 mm nearer than")])
def test_a_belt_that_moved(drift_mm: float, said: str) -> None:
    moved = segmenter("left", gauges={"belt_drift_mm": drift_mm, "belt_alarm": 1.0})
    assert said in texts(with_node(good_state(), "segmenter/left", moved), "trouble")[0]


def test_a_belt_that_leans_is_not_said_to_be_farther() -> None:
    """It was said to be 0 mm nearer than calibrated."""
    leans = segmenter("left", gauges={"belt_drift_mm": -0.2, "belt_tilt_off_deg": 1.42, "belt_alarm": 1.0})
    (text,) = texts(with_node(good_state(), "segmenter/left", leans), "trouble")
    assert "Under camera left the belt leans by 1.4° against its calibration: weights are wrong." in text
    both = segmenter("left", gauges={"belt_drift_mm": -9.0, "belt_tilt_off_deg": 1.42, "belt_alarm": 1.0})
    (text,) = texts(with_node(good_state(), "segmenter/left", both), "trouble")
    assert "the belt is 9 mm nearer than calibrated" in text


@pytest.mark.parametrize(
    ("levels", "level", "said"),
    [
        ({"gauge_cause": 1.0, "gauge_shift_mm": -3.1}, "warning", ["The mount of camera left moved by 3.1 mm."]),
        (
            {"gauge_cause": 2.0, "gauge_drift_px": 0.2},
            "warning",
            ["The depth scale of camera left drifted by +0.20 px; it is corrected."],
        ),
        (
            {"gauge_cause": 2.0, "gauge_drift_px": -0.7, "gauge_beyond": 1.0},
            "trouble",
            ["The depth scale of camera left drifted by -0.70 px; too much to correct: weights are wrong."],
        ),
        ({"gauge_cause": 0.0, "gauge_shift_mm": 0.4, "gauge_unseen": 0.0}, "warning", []),
        ({"gauge_unseen": 1.0}, "warning", ["Camera left does not see its gauge."]),
    ],
)
def test_a_gauge_names_what_moved(levels: dict[str, float], level: str, said: list[str]) -> None:
    assert texts(with_node(good_state(), "segmenter/left", segmenter("left", gauges=levels)), level) == said
