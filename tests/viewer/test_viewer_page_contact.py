"""What the page says of a line that is not heard, was stopped or is complete: by values, without a link."""

from __future__ import annotations

from dataclasses import replace

import pytest

import viewer.page.watch as watch
from conveyor.config import LinkConfig
from conveyor.taken_port import free_port
from tests.conftest import wait_until
from tests.viewer.page_states import camera_info, good_state, loaded_state, totals
from tests.viewer.test_viewer_page_alarms import texts
from viewer.page.alarms import alarms
from viewer.page.snapshot import snapshot
from viewer.page.state import LineState


def test_old_totals_are_told_though_cameras_live() -> None:
    state = good_state(totals_age_s=40.0)
    assert texts(state, "trouble") == ["These figures are 40 s old: the aggregator sends none."]
    assert snapshot(state)["load"]["old"]


def test_no_contact_is_the_one_thing_to_say_and_nothing_flows() -> None:
    state = good_state(heard_s=14.0, totals_age_s=14.0)
    (alarm,) = alarms(state)
    assert alarm.text == "No contact with line north for 14 s."
    shown = snapshot(state)
    assert (shown["state"], shown["heard_s"], shown["flow"]) == ("no contact", 14.0, None)
    never = LineState("north", no_router="tcp/10.0.0.1:7447")
    assert alarms(never)[0].text == "No contact with line north. No router answers at tcp/10.0.0.1:7447."


def test_a_router_that_dies_is_not_told_as_the_end_of_every_process() -> None:
    """For 3 s the page said of each camera that it had stopped and lost frames, and that no regressor was running."""
    state = good_state(heard_s=0.6)
    cut = {name: replace(found, alive=False, gone_s=0.2) for name, found in state.nodes.items()}
    (alarm,) = alarms(replace(state, nodes=cut))
    assert (alarm.key, alarm.text) == ("no-contact", "No contact with line north for 0 s.")
    assert snapshot(replace(state, nodes=cut))["state"] == "no contact"
    one_left = {**cut, "camera/left": state.nodes["camera/left"]}
    assert "Camera right stopped 0 s ago." in texts(replace(state, nodes=one_left), "trouble")
    ended = {
        name: replace(found, report=found.report and replace(found.report, status="ended"))
        for name, found in cut.items()
    }
    assert "no-contact" not in {alarm.key for alarm in alarms(replace(state, nodes=ended))}, "they said goodbye"


def test_a_line_that_was_stopped_on_purpose_may_not_be_counting_on() -> None:
    """It was told as trouble: look at the cameras' cables, no regressor is running; then that it has no contact and may
    still be counting."""
    state = good_state(heard_s=900.0, totals_age_s=900.0)
    nodes = {
        name: replace(found, alive=False, gone_s=900.0, report=found.report and replace(found.report, status="ended"))
        for name, found in state.nodes.items()
    }
    stopped = replace(state, nodes=nodes, no_router="tcp/10.0.0.1:7447")
    (alarm,) = alarms(stopped)
    assert (alarm.level, alarm.text) == ("note", "The line was stopped 15 min ago.")
    shown = snapshot(stopped)
    assert (shown["state"], shown["load"]["old"], shown["flow"]) == ("stopped", False, None)
    assert {camera["state"] for camera in shown["cameras"]} == {"ended"}
    killed = {**nodes, "camera/left": replace(state.nodes["camera/left"], alive=False, gone_s=900.0)}
    assert snapshot(replace(stopped, nodes=killed))["state"] == "no contact", "one said no goodbye: it may count on"
    again = replace(
        stopped, nodes={**nodes, "aggregator/aggregator": state.nodes["aggregator/aggregator"]}, heard_s=0.4
    )
    assert snapshot(again)["state"] == "trouble", "the line is there, and its cameras are not"


def test_a_load_of_which_no_belt_was_seen_yet_has_no_weight() -> None:
    """In the list it had 0.00 kg, and surely so: 0.00 to 0.00."""
    state = loaded_state()
    assert state.totals is not None
    assert state.totals.load is not None
    begun = replace(state.totals.load, count=0, coverage=None, estimated_weight_g=0.0)
    shown = snapshot(replace(state, totals=replace(state.totals, load=begun)))["told"]
    assert [load["weight_g"] for load in shown] == [None, 206.4e3, 206.4e3]


def test_a_complete_load_does_not_grow_old() -> None:
    state = good_state(heard_s=600.0, totals_age_s=600.0, totals=totals(final=True))
    (alarm,) = alarms(state)
    assert (alarm.level, "10 min" in alarm.text) == ("note", True)
    shown = snapshot(state)
    assert (shown["state"], shown["load"]["old"]) == ("complete", False)


def test_cameras_of_a_line_that_was_switched_off_have_ended() -> None:
    """A live camera that is stopped says nothing more: its last word, that it streams, was told as working."""
    state = good_state(heard_s=600.0, totals_age_s=600.0, totals=totals(final=True))
    assert {camera["state"] for camera in snapshot(state)["cameras"]} == {"ok"}, "it goes on, after the run"
    off = {name: replace(found, alive=False, gone_s=600.0) for name, found in state.nodes.items()}
    assert {camera["state"] for camera in snapshot(replace(state, nodes=off))["cameras"]} == {"ended"}
    failed = {**state.cameras, "left": camera_info("left", state="failed")}
    shown = snapshot(replace(state, nodes=off, cameras=failed))["cameras"]
    assert [camera["state"] for camera in shown] == ["failed", "ended"]


def test_a_router_that_stays_away_is_told_by_the_page_and_logged_once_a_minute(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Beside a line that is stopped for the night the page's log grew by ten lines a minute."""
    monkeypatch.setattr(watch, "CONNECT_WITHIN_S", 0.2)
    monkeypatch.setattr(watch, "RETRY_S", 0.1)
    router, told = f"tcp/127.0.0.1:{free_port()}", list[LineState]()
    away = watch.LineWatch(LinkConfig(router=router), line="north", tell=told.append)
    with caplog.at_level("WARNING", logger="page/north"):
        away.start()
        wait_until(lambda: len(told) >= 3, what="three tries")
        away.stop()
    assert {state.no_router for state in told} == {router}
    assert [record.getMessage().partition(" within")[0] for record in caplog.records] == [
        f"no router answered at {router}"
    ]
