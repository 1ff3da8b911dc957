"""What the operator's page says is wrong, and that it never shows old figures as new ones."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from conveyor.messages import CameraExchanged, CamerasApart, HeightChange
from tests.viewer.page_states import camera_info, good_state, loaded_state, node, segmenter, totals, with_node
from viewer.page.alarms import alarms
from viewer.page.snapshot import FORGET_GONE_S, MAX_NODES, snapshot
from viewer.page.state import STALE_S, LineState
from viewer.page.words import FRAME_DROPS, said, span


def texts(state: LineState, level: str) -> list[str]:
    return [alarm.text for alarm in alarms(state) if alarm.level == level]


def test_all_is_well() -> None:
    assert alarms(good_state()) == ()
    shown = snapshot(good_state())
    assert shown["state"] == "running"
    assert [camera["state"] for camera in shown["cameras"]] == ["ok", "ok"]
    assert shown["cameras"][0]["drops"] == {"too_old": 7}
    assert shown["load"]["seen_g"][1] == pytest.approx(172 * 11590)
    json.dumps(shown, allow_nan=False)


def test_a_dark_camera_is_told_with_how_long_and_what_to_do() -> None:
    dark = segmenter("left", gauges={"frames_dropped_blind": 360.0}, growing_s={"frames_dropped_blind": 12.4})
    state = with_node(good_state(), "segmenter/left", dark)
    (alarm,) = alarms(state)
    assert (alarm.key, alarm.level, alarm.text) == ("camera-left-blind", "trouble", "Camera left is dark, for 12 s.")
    assert "light" in alarm.fix
    shown = snapshot(state)
    assert shown["state"] == "trouble"
    assert [camera["state"] for camera in shown["cameras"]] == ["trouble", "ok"]
    second = segmenter("left-2", growing_s=dark.growing_s)
    shown = snapshot(with_node(good_state(), "segmenter/left-2", second))
    told = {camera["name"]: camera["state"] for camera in shown["cameras"]}
    assert told == {"left": "ok", "left-2": "trouble", "right": "ok"}, "'left' was shown red for 'left-2'"


def test_drops_that_are_over_are_history_and_no_alarm() -> None:
    state = with_node(good_state(), "segmenter/left", segmenter("left", gauges={"frames_dropped_blind": 360.0}))
    assert alarms(state) == ()
    assert snapshot(state)["cameras"][0]["drops"] == {"blind": 360, "too_old": 7}


def test_nodes_of_another_version_are_told_with_both() -> None:
    state = good_state()
    for name, found in list(state.nodes.items()):
        if name.startswith("segmenter/") and found.report:
            other = replace(found, report=replace(found.report, version="0.0.9"))
            state = with_node(state, name, other)
    (text,) = texts(state, "warning")
    assert text == "Version 0.0.9 on segmenter/left and 1 more; the line runs 0.1.0."
    everybody = {n: replace(f, report=f.report and replace(f.report, version="0.0.9")) for n, f in state.nodes.items()}
    assert alarms(replace(state, nodes=everybody)) == ()


@pytest.mark.parametrize(("lower_mm", "said"), [(3.14, "3.1 mm (± 0.8) lower"), (-2.5, "2.5 mm (± 0.8) higher")])
def test_tubers_that_lie_lower_than_in_earlier_loads(lower_mm: float, said: str) -> None:
    state = loaded_state()
    assert state.totals is not None
    assert state.totals.load is not None
    change = HeightChange("left", lower_mm, 0.5, -1.2, 2.0, 900, 3, alarm=True)
    load = replace(state.totals.load, heights=(change, replace(change, cameras="right", alarm=False)))
    (alarm,) = [a for a in alarms(replace(state, totals=replace(state.totals, load=load))) if "heights" in a.key]
    assert (alarm.key, alarm.level) == ("camera-left-heights", "warning")
    assert f"Under camera left tubers lie {said} than in earlier loads" in alarm.text
    assert "Height over width: -1 % (± 3)" in alarm.text
    assert "calibrate bucket" in alarm.fix


@pytest.mark.parametrize(
    ("twice", "level", "said"),
    [(9, "trouble", ": 9 of 21 were counted twice."), (0, "warning", "None is counted twice yet")],
)
def test_cameras_that_put_the_same_tubers_at_different_places(twice: int, level: str, said: str) -> None:
    state = good_state()
    assert state.totals is not None
    apart = CamerasApart("left", "right", -3.2, 41.7, shared=21, twice=twice, alarm=True)
    agree = replace(apart, first="rear", alarm=False)
    (alarm,) = alarms(replace(state, totals=replace(state.totals, apart=(agree, apart))))
    assert (alarm.key, alarm.level) == ("apart-left-right", level)
    assert "Cameras left and right put the same tubers 3 mm apart along the belt and 42 mm across" in alarm.text
    assert said in alarm.text
    assert "calibrate cameras" in alarm.fix


def test_a_camera_that_is_not_the_one_that_was_calibrated() -> None:
    state = good_state()
    assert state.totals is not None
    change = CameraExchanged("left", "serial 77, 848x480", "serial 78, 848x480", 1)
    (alarm,) = alarms(replace(state, totals=replace(state.totals, exchanged=(change,))))
    assert (alarm.key, alarm.level) == ("camera-left-exchanged", "warning")
    assert "it was serial 77, 848x480, it is serial 78, 848x480." in alarm.text
    assert "enter the ticket of a load since" in alarm.fix


@pytest.mark.parametrize("reason", sorted(FRAME_DROPS))
def test_every_reason_to_drop_a_frame_has_words(reason: str) -> None:
    state = with_node(good_state(), "segmenter/right", segmenter("right", growing_s={f"frames_dropped_{reason}": 5.0}))
    (alarm,) = alarms(state)
    assert alarm.text.startswith("Camera right ")
    assert reason not in alarm.text.split()


def test_a_reason_without_words_is_shown_by_its_name() -> None:
    state = with_node(good_state(), "segmenter/right", segmenter("right", growing_s={"frames_dropped_new_thing": 5.0}))
    assert texts(state, "trouble") == ["Frames of camera right have been dropped for 5 s: new thing."]


def test_views_that_are_left_out_ask_for_more_regressors() -> None:
    state = with_node(good_state(), "segmenter/left", segmenter("left", growing_s={"views_lost_shed": 9.0}))
    (alarm,) = alarms(state)
    assert (alarm.level, alarm.fix) == ("warning", said("lost.shed.todo"))


@pytest.mark.parametrize(
    ("refused_per_s", "weighed_per_s", "growing_s", "told"),
    [(8.0, 50.0, 6.0, True), (8.0, 0.0, 6.0, True), (8.0, 50.0, 2.0, False), (1.0, 50.0, 60.0, False)],
)
def test_a_regressor_whose_views_cannot_be_weighed_is_told_a_flat_clod_is_not(
    refused_per_s: float, weighed_per_s: float, growing_s: float, told: bool
) -> None:
    """The alarm listened to a count that no view of a camera can raise."""
    regressor = node(
        "regressor/r1",
        per_s={"views_weighed": weighed_per_s, "views_refused_below_belt": refused_per_s},
        growing_s={"views_refused_below_belt": growing_s},
    )
    found = texts(with_node(good_state(), "regressor/r1", regressor), "warning")
    assert found == (["Regressor r1 gets views that cannot be weighed."] if told else [])


def test_a_camera_without_frames() -> None:
    state = with_node(good_state(), "segmenter/left", segmenter("left", resting_s={"frames_processed": 8.0}))
    assert texts(state, "trouble") == ["No frames have come from camera left for 8 s."]


def test_a_dead_camera_is_told_by_the_belt_that_its_segmenter_no_longer_sees_move() -> None:
    heard = good_state(frame_s={"left": 1.9, "right": 0.1})
    assert texts(heard, "trouble") == ["No frames have come from camera left for 1 s."]
    assert snapshot(heard)["cameras"][0]["state"] == "trouble"
    assert alarms(good_state(frame_s={"left": 1.7})) == ()
    waits = {"left": camera_info("left", waits=True), "right": camera_info("right")}
    assert alarms(replace(heard, cameras=waits)) == (), "a replay may wait"
    silent = with_node(heard, "segmenter/left", segmenter("left", age_s=2.1))
    assert alarms(silent) == (), "nothing is heard of its segmenter either: that is the link, and told as such"
    dropping = segmenter("left", growing_s={"frames_dropped_too_old": 1.0})
    assert alarms(with_node(heard, "segmenter/left", dropping)) == (), "frames come, too late"
    fresh = segmenter("left")
    assert fresh.report is not None
    fresh = replace(fresh, report=replace(fresh.report, uptime_s=1.2))
    away = good_state(frame_s={"left": 6.0})
    assert alarms(with_node(away, "segmenter/left", fresh)) == (), "it was the segmenter that was away"


def test_a_recorder_that_ended_on_purpose_is_no_trouble() -> None:
    ended = node("recorder/rec", alive=False, gone_s=20.0)
    assert ended.report is not None
    ended = replace(ended, report=replace(ended.report, status="ended"))
    state = with_node(good_state(), "recorder/rec", ended)
    shown = snapshot(state)
    assert (shown["state"], [alarm["level"] for alarm in shown["alarms"]]) == ("running", [])
    assert shown["health"] == {"processes": 8, "well": 7, "ended": ["recorder/rec"], "ill": {}}
    killed = with_node(state, "recorder/rec", node("recorder/rec", alive=False, gone_s=20.0))
    assert snapshot(killed)["health"]["ill"] == {"recorder/rec": "gone"}
    camera = replace(ended, report=replace(ended.report, role="camera", name="left"))
    stopped = with_node(good_state(), "camera/left", camera)
    assert texts(stopped, "trouble") == ["Camera left stopped 20 s ago."], "the load misses its belt, on purpose or not"


def test_processes_that_are_gone_hang_or_start() -> None:
    state = good_state()
    gone = replace(state.nodes["camera/left"], alive=False, gone_s=31.0)
    hangs = node("aggregator/aggregator")
    assert hangs.report is not None
    hangs = replace(hangs, report=replace(hangs.report, status="stalled"))
    starting = replace(state.nodes["segmenter/right"], alive=False, gone_s=None)
    state = with_node(
        with_node(with_node(state, "camera/left", gone), "aggregator/aggregator", hangs), "segmenter/right", starting
    )
    assert texts(state, "trouble") == [
        "Camera left stopped 31 s ago.",
        "aggregator/aggregator on edge hangs.",
    ]
    assert [camera["state"] for camera in snapshot(state)["cameras"]] == ["gone", "starting"]


def test_a_receiver_that_is_gone_loses_positions() -> None:
    """The page stayed green: "Good. No alarms."; the map lacked what was driven meanwhile."""
    gone = node("gnss/gnss", alive=False, gone_s=12.0)
    (alarm,) = alarms(with_node(good_state(), "gnss/gnss", gone))
    assert (alarm.key, alarm.level) == ("gnss-gnss-gone", "warning")
    assert "GNSS receiver is gone, for 12 s: positions are lost" in alarm.text
    assert gone.report is not None
    ended = replace(gone, report=replace(gone.report, status="ended"))
    assert alarms(with_node(good_state(), "gnss/gnss", ended)) == ()


def test_nobody_weighs() -> None:
    state = with_node(with_node(good_state(), "regressor/r1", None), "regressor/r2", None)
    waiting = segmenter("left", gauges={"views_outstanding": 41.0})
    (alarm,) = alarms(with_node(state, "segmenter/left", waiting))
    assert (alarm.level, "41 views wait" in alarm.text) == ("trouble", True)


def test_a_regressor_that_left_is_noted_for_a_minute_and_forgotten_after_ten() -> None:
    state = good_state()
    left = replace(state.nodes["regressor/r2"], alive=False, gone_s=20.0)
    assert texts(with_node(state, "regressor/r2", left), "note") == [
        "Regressor r2 left 20 s ago; the others took over its work."
    ]
    long_gone = with_node(state, "regressor/r2", replace(left, gone_s=FORGET_GONE_S + 1))
    assert alarms(long_gone) == ()
    assert [shown["name"] for shown in snapshot(long_gone)["regressors"]] == ["r1"]


@pytest.mark.parametrize("status", ["ended", "ok"])
def test_of_regressors_that_all_left_nobody_took_over(status: str) -> None:
    """'No regressor is running' stood above 'the others took over its work'."""
    state = good_state()
    for name in ("regressor/r1", "regressor/r2"):
        left = replace(state.nodes[name], alive=False, gone_s=0.0)
        assert left.report is not None
        state = with_node(state, name, replace(left, report=replace(left.report, status=status)))
    assert [alarm.key for alarm in alarms(state)] == ["no-regressor"]
    only = with_node(state, "regressor/r2", None)
    assert [alarm.key for alarm in alarms(only)] == ["no-regressor"]
    back = with_node(state, "regressor/r2", good_state().nodes["regressor/r2"])
    assert [alarm.key for alarm in alarms(back)] == ["regressor-r1-left"]


def test_a_thousand_names_end_somewhere() -> None:
    state = good_state()
    for n in range(1000):
        state = replace(
            state, nodes={**state.nodes, f"regressor/x{n}": node(f"regressor/x{n}", alive=False, gone_s=9.0)}
        )
    shown = snapshot(state)
    assert len(shown["regressors"]) == MAX_NODES
    assert {"r1", "r2"} <= {regressor["name"] for regressor in shown["regressors"]}
    assert len(shown["alarms"]) <= 24


def test_belt_that_was_not_looked_at() -> None:
    state = good_state(totals=totals(coverage=0.93))
    assert texts(state, "warning") == ["7.0 % of the belt was not looked at. The estimate makes up for it."]
    assert snapshot(state)["state"] == "warned", "it said 'running', and on a phone the warning is two screens below"


def test_who_does_not_count_yet_is_not_told_as_running() -> None:
    state = good_state(totals=totals(state="starting", reason="camera right has not said anything yet", count=0))
    assert texts(state, "warning") == ["Starting, not counting: camera right has not said anything yet."]
    assert snapshot(state)["state"] == "waiting"


def test_a_little_belt_in_layers_is_not_none() -> None:
    (text,) = texts(good_state(totals=totals(layered_m=0.4, belt_m=200.0, hidden=3.2)), "warning")
    assert text.startswith("Tubers lie in more than one layer on <1 % of the belt: 3 hidden, estimated.")


def test_a_replay_that_waits_has_no_gaps_while_a_frame_is_under_way() -> None:
    waits = {name: camera_info(name, waits=True, refused={"broken_png": 2}) for name in ("left", "right")}
    ahead = segmenter("left", gauges={"frames_gaps": 3.0}, growing_s={"frames_gaps": 9.0})
    state = with_node(good_state(cameras=waits), "segmenter/left", ahead)
    assert alarms(state) == ()
    assert snapshot(state)["cameras"][0]["gaps"] == 2


def test_a_failed_camera_says_why() -> None:
    failed = {
        "left": camera_info("left", state="failed", error="the RealSense was unplugged"),
        "right": camera_info("right"),
    }
    assert texts(good_state(cameras=failed), "trouble") == ["Camera left failed: the RealSense was unplugged"]


@pytest.mark.parametrize(("seconds", "said"), [(0.2, "0 s"), (119.9, "119 s"), (120, "2 min"), (7300, "2 h 1 min")])
def test_spans(seconds: float, said: str) -> None:
    assert span(seconds) == said


def test_a_figure_is_stale_after_a_few_missed_reports_not_after_one() -> None:
    assert 2.0 < STALE_S < 5.0


def test_a_camera_of_which_no_frame_was_processed_yet_is_starting() -> None:
    """It was called working, beside 'no frame processed yet'."""
    first = segmenter("left", gauges={"frames_published": 0.0, "frames_processed": 0.0}, per_s={})
    cameras = snapshot(with_node(good_state(), "segmenter/left", first))["cameras"]
    assert [(camera["state"], camera["per_s"]) for camera in cameras] == [("starting", None), ("ok", 29.9)]
