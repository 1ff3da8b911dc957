"""`tuberline page` as its own process on a real line: figures arrive, grow old, come back; and it holds no one up."""

from __future__ import annotations

import http.client
import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

import pytest
import zenoh

from conveyor import topics
from conveyor.access import line_identities
from conveyor.config import LineConfig, LinkConfig
from conveyor.delivery import KeptPublisher, LatestPublisher
from conveyor.errors import ConfigError
from conveyor.messages import Position, Travel
from conveyor.node import Node
from conveyor.taken_port import free_port
from tests.conftest import wait_until
from tests.viewer.viewer_line import camera_info, potatoes, totals
from tuberline.cli.commands import build_app
from viewer.page.alarms import alarms
from viewer.page.maps import FieldMaps
from viewer.page.state import LineState
from viewer.page.watch import LineWatch

RUN = "load-7"
PATIENCE_S = 60.0


class Page:
    """A page process, asked as a browser would."""

    def __init__(self, process: subprocess.Popen[bytes], port: int) -> None:
        self.process = process
        self.port = port

    def lines(self) -> dict[str, dict[str, Any]]:
        """What it shows, by line; nothing while it is not there."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        try:
            connection.request("GET", "/snapshot.json")
            return {line["line"]: line for line in json.loads(connection.getresponse().read())["lines"]}
        except OSError:
            return {}
        finally:
            connection.close()


@contextmanager
def page(link: LinkConfig, port: int, *lines: str) -> Iterator[Page]:
    """The page of some lines at one router."""
    command = [sys.executable, "-m", "tuberline", "page", "--connect", link.router, "--listen", f"127.0.0.1:{port}"]
    process = subprocess.Popen([*command, *(word for line in lines for word in ("--line", line))])
    try:
        yield Page(process, port)
    finally:
        if process.poll() is None:
            process.kill()
        process.wait(30)


@pytest.mark.graph
def test_a_line_is_shown_grows_old_and_comes_back(link: LinkConfig) -> None:
    tubers = potatoes(40, seed=3)
    config = LineConfig(name="north", link=link)
    with page(link, free_port(), "north", "south") as shown:
        with Node("aggregator", "aggregator", config=config, run=RUN) as node:
            kept = KeptPublisher(node, topics.TOTALS)
            infos = KeptPublisher(node, topics.CAMERA_INFO, camera="front")
            travels = LatestPublisher(node, topics.TRAVEL, source="front")
            asked = node.session.declare_queryable(
                topics.QUERY_LOADS.key("north"),
                lambda query: query.reply(query.key_expr, json.dumps([_past(n) for n in (2, 1)])),
            )
            infos.put(camera_info())
            deadline = time.monotonic() + PATIENCE_S
            north: dict[str, Any] = {}
            for second in range(10_000):
                node.progress()
                kept.put(totals(tubers))
                travels.put(Travel("front", RUN, second * 200_000_000, 0.084 * second, True))
                north = shown.lines().get("north", {})
                if north.get("loads") and (north.get("flow") or {}).get("belt_m_per_s"):
                    break
                assert time.monotonic() < deadline, north
                time.sleep(0.1)
            asked.undeclare()
        assert north["load"]["count"] == 40
        assert north["load"]["seen_g"][1] == pytest.approx(sum(t.weight_g for t in tubers))
        assert north["flow"]["belt_m_per_s"] == pytest.approx(0.42)
        assert [load["run"] for load in north["loads"]] == ["load-2", "load-1"]
        assert [camera["name"] for camera in north["cameras"]] == ["front"]
        assert shown.lines()["south"]["state"] == "no contact", "two lines at one router do not see each other"
        wait_until(
            lambda: shown.lines()["north"]["state"] == "no contact", what="the line's silence", timeout_s=PATIENCE_S
        )
        assert shown.lines()["north"]["heard_s"] >= 3.5
        assert shown.lines()["north"]["health"]["ended"] == ["aggregator/aggregator"], "it went on purpose, and said so"
        with Node("aggregator", "aggregator", config=config, run=RUN) as node:
            kept = KeptPublisher(node, topics.TOTALS)

            def back() -> bool:
                kept.put(totals(tubers[:7]))
                return bool(shown.lines()["north"]["load"]["count"] == 7)

            wait_until(back, what="the line is back", timeout_s=PATIENCE_S)
        shown.process.send_signal(signal.SIGTERM)
        assert shown.process.wait(20) == 0


@pytest.mark.graph
def test_another_run_has_a_way_of_its_own(link: LinkConfig) -> None:
    """The way of the run before stood beneath the new one's, with its cells, until the page was started again."""
    config, maps = LineConfig(name="north", link=link), FieldMaps()
    watch = LineWatch(link, line="north", tell=lambda look: None, maps=maps)
    watch.start()
    at: dict[str, Any] = {"config": config, "run": RUN}
    with Node("aggregator", "aggregator", **at) as node, Node("gnss", "roof", **at) as gnss:
        kept, places = KeptPublisher(node, topics.TOTALS), LatestPublisher(gnss, topics.POSITION, receiver="roof")

        def way(run: str, north_deg: float) -> list[float]:
            """Degrees north of the way, where `run` goes on there."""
            node.progress()
            gnss.progress()
            kept.put(replace(totals(potatoes(4, seed=3)), run=run))
            places.put(Position("roof", "any", 0, 1, 1, north_deg, 5.0, 4, 0.8, 9))
            return [lat for _, lat in json.loads(maps.newest("north"))["way"]]

        wait_until(lambda: way("monday", 52.0) == [52.0], what="the first run's place", timeout_s=PATIENCE_S)
        wait_until(lambda: way("monday", 52.1) == [52.0, 52.1], what="its way", timeout_s=PATIENCE_S)
        maps.put_cells("north", [{"type": "Feature"}], {"mean": 40.0})
        before = maps.number("north")
        wait_until(lambda: way("tuesday", 52.2) == [52.2], what="the second run's way", timeout_s=PATIENCE_S)
        found = json.loads(maps.newest("north"))
        assert (found["cells"]["features"], found["about"]) == ([], {})
        assert found["number"] > before, "browsers fetch it"
        wait_until(lambda: way("tuesday", 52.3) == [52.2, 52.3], what="its way", timeout_s=PATIENCE_S)
    watch.stop()


@pytest.mark.graph
def test_another_run_is_not_told_what_is_left_of_the_run_before(link: LinkConfig) -> None:
    """Each start was trouble: its segmenter had stopped 27 s ago, no regressor was running, no frames had come for 7
    minutes; its camera had ended, and the last change could be undone."""
    config, looks = LineConfig(name="north", link=link), list[LineState]()
    watch = LineWatch(link, line="north", tell=looks.append)
    watch.start()
    others = ("camera", "front"), ("segmenter", "front"), ("regressor", "r1")

    def shown(look: LineState, run: str) -> bool:
        return look.totals is not None and look.totals.run == run

    with ExitStack() as monday:
        node = monday.enter_context(Node("aggregator", "aggregator", config=config, run="monday"))
        nodes = [monday.enter_context(Node(*who, config=config, run="monday")) for who in others]
        kept, infos = KeptPublisher(node, topics.TOTALS), KeptPublisher(nodes[0], topics.CAMERA_INFO, camera="front")

        def heard() -> bool:
            for each in (node, *nodes):
                each.progress()
            kept.put(totals(potatoes(4, seed=3), run="monday"))
            infos.put(replace(camera_info(run="monday"), state="ended"))
            return bool(looks) and shown(looks[-1], "monday") and len(looks[-1].nodes) == 4 and bool(looks[-1].cameras)

        wait_until(heard, what="the first run", timeout_s=PATIENCE_S)
    wait_until(lambda: "camera/front" in looks[-1].nodes and looks[-1].nodes["camera/front"].left, what="its end")
    with Node("aggregator", "aggregator", config=config, run="tuesday") as node:
        kept = KeptPublisher(node, topics.TOTALS)

        def begun() -> bool:
            node.progress()
            kept.put(totals([], run="tuesday"))
            return len([look for look in looks if shown(look, "tuesday")]) > 3

        wait_until(begun, what="the second run", timeout_s=PATIENCE_S)
    watch.stop()
    for look in (look for look in looks if shown(look, "tuesday") and look.in_contact):
        assert [alarm.text for alarm in alarms(look) if alarm.level == "trouble"] == []
        assert (set(look.nodes), look.cameras, look.changed_s) == ({"aggregator/aggregator"}, {}, None)


@pytest.mark.graph
def test_answers_that_are_none_leave_the_page_watching(link: LinkConfig) -> None:
    """The thread that watches the line ended with the first of them, and the page showed it as it was then."""
    config, looks = LineConfig(name="north", link=link), list[LineState]()
    watch = LineWatch(link, line="north", tell=looks.append)
    answers = iter(("no JSON", '"text"', "[7]", '[{"run": 7}]'))
    asked = []

    def answer(query: zenoh.Query) -> None:
        of_loads = "what=loads" in str(query.parameters)
        if not of_loads:
            asked.append(next(answers, json.dumps([_past(1)])))
        query.reply(query.key_expr, "[7]" if of_loads else asked[-1])
        watch.ask_soon()

    with Node("aggregator", "aggregator", config=config, run=RUN) as node:
        held = node.session.declare_queryable(topics.QUERY_LOADS.key("north"), answer)
        watch.start()
        wait_until(lambda: len(asked) > 6 and bool(looks[-1].loads), what="the loads", timeout_s=PATIENCE_S)
        held.undeclare()
    watch.stop()
    assert [load.run for load in looks[-1].loads] == ["load-1"]


def _past(n: int) -> dict[str, Any]:
    figures = {"count": 100 * n, "weight_g": 17000.0 * n, "low_g": None, "high_g": None, "coverage": None}
    return {"run": f"load-{n}", "started_unix_s": 1.79e9 + n, "final": False, **figures}


@pytest.mark.graph
def test_a_frozen_page_holds_nobody_up(link: LinkConfig) -> None:
    config = LineConfig(name="north", link=link)
    with page(link, free_port(), "north") as shown, Node("aggregator", "aggregator", config=config, run=RUN) as node:
        kept = KeptPublisher(node, topics.TOTALS)
        kept.put(totals(potatoes(5, seed=1)))
        wait_until(
            lambda: shown.lines().get("north", {}).get("load"), what="the page shows the line", timeout_s=PATIENCE_S
        )
        shown.process.send_signal(signal.SIGSTOP)
        slowest_s, used_s = 0.0, time.thread_time()
        for n in range(2000):
            started = time.monotonic()
            kept.put(totals(potatoes(n % 50, seed=1)[:3]))
            slowest_s = max(slowest_s, time.monotonic() - started)
        shown.process.send_signal(signal.SIGCONT)
        sys.stdout.write(
            f"slowest put {1e3 * slowest_s:.1f} ms, {time.thread_time() - used_s:.2f} s of processor time\n"
        )
        assert slowest_s < 2.0, "a put waits for no one"
        wait_until(
            lambda: shown.lines().get("north", {}).get("load", {}).get("count") == 3,
            what="it goes on",
            timeout_s=PATIENCE_S,
        )


def test_the_page_is_an_operator_and_operators_send_nothing() -> None:
    assert "operator" in {identity.role for identity in line_identities(LineConfig())}
    for topic in topics.TOPICS:
        assert "operator" not in topic.senders
    heard = {topic.name for topic in topics.TOPICS if "operator" in topic.receivers}
    assert {"totals", "counters", "alive", "camera_info", "travel", "query_loads"} <= heard
    assert not {"frame", "view", "weight", "order_model"} & heard


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--listen", "9180"], "HOST:PORT"),
        (["--listen", "localhost:http"], "HOST:PORT"),
        (["--config", "a.toml", "--line", "b"], "not both"),
        (["--line", "a", "--line", "a"], "the same name"),
        (["--config", "/nowhere/line.toml"], "cannot be read"),
    ],
)
def test_wrong_use_is_refused_in_one_sentence(words: list[str], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        build_app()(["page", *words], exit_on_error=False, print_error=False)
