"""What the operator's page says is wrong, and that it never shows old figures as new ones."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from tests.viewer.page_looks import camera_info, good_look, node, segmenter, totals, with_node
from viewer.page.alarms import alarms
from viewer.page.snapshot import FORGET_GONE_S, MAX_NODES, snapshot
from viewer.page.state import STALE_S, Look
from viewer.page.words import FRAME_DROPS, VIEW_LOSSES, span


def texts(look: Look, level: str) -> list[str]:
    return [alarm.text for alarm in alarms(look) if alarm.level == level]


def test_all_is_well() -> None:
    assert alarms(good_look()) == ()
    shown = snapshot(good_look())
    assert shown["state"] == "running"
    assert [camera["state"] for camera in shown["cameras"]] == ["ok", "ok"]
    assert shown["cameras"][0]["drops"] == {"too old": 7}
    assert shown["load"]["seen_g"][1] == pytest.approx(172 * 11590)
    json.dumps(shown, allow_nan=False)


def test_a_dark_camera_is_told_with_how_long_and_what_to_do() -> None:
    dark = segmenter("left", gauges={"frames_dropped_blind": 360.0}, growing_s={"frames_dropped_blind": 12.4})
    look = with_node(good_look(), "segmenter/left", dark)
    (alarm,) = alarms(look)
    assert (alarm.key, alarm.level, alarm.text) == ("camera-left-blind", "trouble", "Camera left is dark, for 12 s.")
    assert "light" in alarm.mend
    shown = snapshot(look)
    assert shown["state"] == "trouble"
    assert [camera["state"] for camera in shown["cameras"]] == ["trouble", "ok"]


def test_drops_that_are_over_are_history_and_no_alarm() -> None:
    look = with_node(good_look(), "segmenter/left", segmenter("left", gauges={"frames_dropped_blind": 360.0}))
    assert alarms(look) == ()
    assert snapshot(look)["cameras"][0]["drops"] == {"dark or covered": 360, "too old": 7}


@pytest.mark.parametrize(("drift_mm", "said"), [(14.2, "14 mm further than"), (-7.0, "7 mm nearer than")])
def test_a_belt_that_moved(drift_mm: float, said: str) -> None:
    moved = segmenter("left", gauges={"belt_drift_mm": drift_mm, "belt_alarm": 1.0})
    assert said in texts(with_node(good_look(), "segmenter/left", moved), "trouble")[0]


@pytest.mark.parametrize("reason", sorted(FRAME_DROPS))
def test_every_reason_to_drop_a_frame_has_words(reason: str) -> None:
    look = with_node(good_look(), "segmenter/right", segmenter("right", growing_s={f"frames_dropped_{reason}": 5.0}))
    (alarm,) = alarms(look)
    assert alarm.text.startswith("Camera right ")
    assert reason not in alarm.text.split()


def test_a_reason_without_words_is_shown_by_its_name() -> None:
    look = with_node(good_look(), "segmenter/right", segmenter("right", growing_s={"frames_dropped_new_thing": 5.0}))
    assert texts(look, "trouble") == ["Frames of camera right have been dropped for 5 s: new thing."]


def test_views_that_are_left_out_ask_for_more_regressors() -> None:
    look = with_node(good_look(), "segmenter/left", segmenter("left", growing_s={"views_lost_shed": 9.0}))
    (alarm,) = alarms(look)
    assert (alarm.level, alarm.mend) == ("look", VIEW_LOSSES["shed"].mend)


def test_a_camera_without_frames() -> None:
    look = with_node(good_look(), "segmenter/left", segmenter("left", resting_s={"frames_processed": 8.0}))
    assert texts(look, "trouble") == ["No frames have come from camera left for 8 s."]


def test_processes_that_are_gone_hang_or_start() -> None:
    look = good_look()
    gone = replace(look.nodes["camera/left"], alive=False, gone_s=31.0)
    hangs = node("aggregator/aggregator")
    assert hangs.report is not None
    hangs = replace(hangs, report=replace(hangs.report, status="stalled"))
    starting = replace(look.nodes["segmenter/right"], alive=False, gone_s=None)
    look = with_node(
        with_node(with_node(look, "camera/left", gone), "aggregator/aggregator", hangs), "segmenter/right", starting
    )
    assert texts(look, "trouble") == [
        "Camera left has been away for 31 s.",
        "aggregator/aggregator on edge hangs.",
    ]
    assert [camera["state"] for camera in snapshot(look)["cameras"]] == ["gone", "starting"]


def test_nobody_weighs() -> None:
    look = with_node(with_node(good_look(), "regressor/r1", None), "regressor/r2", None)
    waiting = segmenter("left", gauges={"views_outstanding": 41.0})
    (alarm,) = alarms(with_node(look, "segmenter/left", waiting))
    assert (alarm.level, "41 views wait" in alarm.text) == ("trouble", True)


def test_a_regressor_that_left_is_noted_for_a_minute_and_forgotten_after_ten() -> None:
    look = good_look()
    left = replace(look.nodes["regressor/r2"], alive=False, gone_s=20.0)
    assert texts(with_node(look, "regressor/r2", left), "note") == [
        "Regressor r2 left 20 s ago; the others took over its work."
    ]
    long_gone = with_node(look, "regressor/r2", replace(left, gone_s=FORGET_GONE_S + 1))
    assert alarms(long_gone) == ()
    assert [shown["name"] for shown in snapshot(long_gone)["regressors"]] == ["r1"]


def test_a_thousand_names_end_somewhere() -> None:
    look = good_look()
    for n in range(1000):
        look = replace(look, nodes={**look.nodes, f"regressor/x{n}": node(f"regressor/x{n}", alive=False, gone_s=9.0)})
    shown = snapshot(look)
    assert len(shown["regressors"]) == MAX_NODES
    assert {"r1", "r2"} <= {regressor["name"] for regressor in shown["regressors"]}
    assert len(shown["alarms"]) <= 24


def test_belt_that_was_not_looked_at() -> None:
    look = good_look(totals=totals(coverage=0.93))
    assert texts(look, "look") == ["7.0 % of the belt was not looked at. The estimate makes up for it."]


def test_old_totals_are_told_though_cameras_live() -> None:
    look = good_look(totals_age_s=40.0)
    assert texts(look, "trouble") == ["The load has not been told for 40 s: the figures are old."]
    assert snapshot(look)["load"]["old"]


def test_no_contact_is_the_one_thing_to_say_and_nothing_flows() -> None:
    look = good_look(heard_s=14.0, totals_age_s=14.0)
    (alarm,) = alarms(look)
    assert alarm.text == "No contact with line north for 14 s."
    shown = snapshot(look)
    assert (shown["state"], shown["heard_s"], shown["flow"]) == ("no contact", 14.0, None)
    never = Look("north", trouble="No router answers at tcp/10.0.0.1:7447")
    assert alarms(never)[0].text == "No contact with line north. No router answers at tcp/10.0.0.1:7447."


def test_a_complete_load_does_not_grow_old() -> None:
    look = good_look(heard_s=600.0, totals_age_s=600.0, totals=totals(final=True))
    (alarm,) = alarms(look)
    assert (alarm.level, "10 min" in alarm.text) == ("note", True)
    shown = snapshot(look)
    assert (shown["state"], shown["load"]["old"]) == ("complete", False)


def test_a_replay_that_waits_has_no_gaps_while_a_frame_is_under_way() -> None:
    waits = {name: camera_info(name, waits=True, refused={"broken_png": 2}) for name in ("left", "right")}
    eyes = segmenter("left", gauges={"frames_gaps": 3.0}, growing_s={"frames_gaps": 9.0})
    look = with_node(good_look(cameras=waits), "segmenter/left", eyes)
    assert alarms(look) == ()
    assert snapshot(look)["cameras"][0]["gaps"] == 2


def test_a_failed_camera_says_why() -> None:
    failed = {
        "left": camera_info("left", state="failed", error="the RealSense was unplugged"),
        "right": camera_info("right"),
    }
    assert texts(good_look(cameras=failed), "trouble") == ["Camera left failed: the RealSense was unplugged"]


@pytest.mark.parametrize(("seconds", "said"), [(0.2, "0 s"), (119.9, "119 s"), (120, "2 min"), (7300, "2 h 1 min")])
def test_spans(seconds: float, said: str) -> None:
    assert span(seconds) == said


def test_a_figure_is_stale_after_a_few_missed_reports_not_after_one() -> None:
    assert 2.0 < STALE_S < 5.0
