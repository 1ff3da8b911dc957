"""What an alarms process that was started again can and cannot know of what it told before."""

from __future__ import annotations

from dataclasses import replace

import pytest

from conveyor.access import known_nodes
from conveyor.config import CameraConfig, LineConfig
from conveyor.config_alarms import AlarmsConfig
from tests.alarms.alarm_words import message
from tests.viewer.page_states import good_state, node, with_node
from tuberline.alarms.message import AlarmMessage
from tuberline.alarms.seen import FORGOTTEN_AFTER_S, seen_alarms, unknown_keys
from viewer.page.state import LineState

EXPECTED = known_nodes(LineConfig(name="north", cameras={"left": CameraConfig()}))
BEGUN = {
    "regressor-r1-lost": "",
    "regressor-container-7f3a-lost": "",
    "no-regressor": "",
    "camera-left-camera-gone": "left",
    "camera-left-belt": "left",
    "stalled-aggregator/aggregator": "",
    "coverage-monday": "",
    "camera-left-heights": "left",
    "camera-left-exchanged": "left",
}


def unknown(state: LineState, *, later_s: float = 5.0) -> set[str]:
    active: dict[str, AlarmMessage] = {
        key: replace(message(n), key=key, camera=camera) for n, (key, camera) in enumerate(BEGUN.items())
    }
    unix_s = message(0).since_unix_s + later_s
    return set(unknown_keys(state, active, EXPECTED, disks_known=True, unix_s=unix_s))


def only(state: LineState, *names: str) -> LineState:
    return replace(state, nodes={name: state.nodes[name] for name in names})


def test_nothing_is_known_of_processes_that_were_not_heard_of() -> None:
    told = {"coverage-monday", "camera-left-heights", "camera-left-exchanged"}
    assert unknown(only(good_state(), "segmenter/right")) == BEGUN.keys() - told
    assert unknown(only(good_state(), "camera/left")) == BEGUN.keys() - told - {"camera-left-camera-gone"}
    assert unknown(only(good_state(), "segmenter/left")) == BEGUN.keys() - told - {"camera-left-belt"}
    assert unknown(with_node(good_state(), "regressor/container-7f3a", node("regressor/container-7f3a"))) == set()


def test_who_has_just_come_has_said_nothing_yet() -> None:
    came = replace(good_state().nodes["regressor/r1"], report=None, age_s=0.3, there_s=0.3)
    state = with_node(good_state(), "regressor/r1", came)
    assert unknown(state) == {"regressor-r1-lost", "regressor-container-7f3a-lost"}
    assert "no-regressor" in unknown(only(state, "segmenter/left", "regressor/r1"))


def test_others_take_over_where_there_are_others() -> None:
    """Also the only regressor's alarm said that they did."""

    def told(*names: str) -> list[str]:
        gone = replace(good_state().nodes["regressor/r1"], alive=False, gone_s=1.0)
        state = only(with_node(good_state(), "regressor/r1", gone), "segmenter/left", *names)
        config = LineConfig(
            name="north", cameras={"left": CameraConfig()}, alarms=AlarmsConfig(channels=("http://127.0.0.1:1",))
        )
        alarms = seen_alarms(state, config, [])
        return [alarm.text for alarm in alarms if alarm.key == "regressor-r1-lost"]

    assert told("regressor/r1") == ["Regressor r1 is gone."]
    assert told("regressor/r1", "regressor/r2") == ["Regressor r1 is gone; the others take over its work."]


def test_a_process_of_no_config_is_not_waited_for_without_end() -> None:
    state = only(good_state(), "segmenter/right")
    late = unknown(state, later_s=FORGOTTEN_AFTER_S)
    assert unknown(state) - late == {"regressor-container-7f3a-lost"}


@pytest.mark.parametrize("heard_s", [None, 60.0])
def test_without_contact_nothing_is_known_and_at_a_load_s_end_everything(heard_s: float | None) -> None:
    assert unknown(replace(good_state(), heard_s=heard_s, nodes={})) == BEGUN.keys()
    over = good_state()
    assert over.totals is not None
    assert unknown(replace(over, heard_s=heard_s, nodes={}, totals=replace(over.totals, final=True))) == set()


@pytest.mark.parametrize(
    ("age_s", "there_s", "expected"),
    [(40.0, 0.3, "starting"), (3.6, 3.6, "silent"), (3.6, 90.0, "silent"), (0.3, 90.0, "ok")],
)
def test_who_came_a_moment_ago_is_not_silent(age_s: float, there_s: float, expected: str) -> None:
    found = node("regressor/r1", age_s=age_s, there_s=there_s)
    assert found.state == expected
    assert replace(found, report=None, age_s=there_s).state == ("starting" if there_s < 3.5 else "silent")
