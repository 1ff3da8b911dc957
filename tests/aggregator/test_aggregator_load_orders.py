"""Loads of a line at work, with real processes: aggregator and asker killed at the change, each tuber in its load."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh

from aggregator.core.loads import span_of
from aggregator.ledger.check import check_file
from aggregator.ledger.load_rows import read_book, read_span_sums
from aggregator.ledger.reader import read_sums, read_tubers, reading
from conveyor import topics
from conveyor.config import LineConfig, LinkConfig
from conveyor.load_orders import new_request, send_order
from conveyor.messages import LoadAnswer, LoadOrder
from conveyor.node import Node
from conveyor.observer import Observer
from conveyor.session import open_client
from tests.aggregator.belt_story import CLOCK_S, SPEED_MPS, Story, tell
from tests.aggregator.test_aggregator_node import Process, Segmenters, line, process
from tests.conftest import ROOT, wait_until

__all__ = ["line", "process"]
pytestmark = [pytest.mark.graph, pytest.mark.timeout(180)]
NEAR_M = 0.6
"""Two seconds of belt: how busy this machine is decides when a mark comes."""


class Belt:
    """Plays a story as it happens: each entry is sent when its camera would have sent it."""

    def __init__(self, segmenters: Segmenters) -> None:
        self.story = segmenters.told
        self._segmenters = segmenters
        self.began_s = time.monotonic()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._play, daemon=True)

    @property
    def at_s(self) -> float:
        """Seconds of the story by now."""
        return time.monotonic() - self.began_s

    def place_m(self, at_s: float) -> float:
        """Place at the centre row at that moment of the story."""
        return self.story.cameras[0].x_m - SPEED_MPS * at_s

    def _play(self) -> None:
        sent = dict.fromkeys(self.story.names, 0)
        while not self._stop.wait(0.05) and any(sent[c] < len(log) for c, log in self.story.logs.items()):
            for camera, log in self.story.logs.items():
                # What was not acknowledged is sent again, as a segmenter does for an aggregator that was killed.
                sent[camera] = (
                    max(self._segmenters.acknowledged(camera), 0) if int(self.at_s * 20) % 20 == 0 else sent[camera]
                )
                while sent[camera] < len(log) and due_s(log[sent[camera] :], self.story) <= self.at_s:
                    self._segmenters._out[camera].put(log[sent[camera]])
                    sent[camera] += 1

    def __enter__(self) -> Belt:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()


def due_s(entries: list, story: Story) -> float:  # type: ignore[type-arg]
    """When the first of `entries` was written: with the next mark of its log."""
    mark = next(entry.mark for entry in entries if entry.mark is not None)
    return float(mark.captured_ns / 1e9 - CLOCK_S)


@contextmanager
def loader(config: LineConfig) -> Iterator[Callable[..., LoadAnswer]]:
    with open_client(config.link, name="loader") as session:

        def ask(action: str, request: str | None = None, **more: object) -> LoadAnswer:
            order = LoadOrder(request or new_request(), action, by="test", **more)  # type: ignore[arg-type]
            return send_order(session, "t", order, within_s=40)

        yield ask


def sums_are_those_of_the_places(path: Path) -> dict[int, int]:
    """Tubers by load, from their rows; and that the sums carried along say the same."""
    with reading(path) as view:
        spans, sums = read_book(view).spans["story"], read_span_sums(view, "story")
        found = dict.fromkeys((span.load for span in spans), 0)
        for tuber in read_tubers(view, "story"):
            found[span_of(spans, tuber.place_x_m).load] += 1
        carried = {load: sum(sums[s.n].load.count for s in spans if s.load == load) for load in found}
        assert carried == found
        assert sum(found.values()) == read_sums(view, "story").load.count
    return found


def test_killed_at_the_change_every_tuber_is_in_its_load(line: tuple[LineConfig, Path], process: Process) -> None:
    config, path = line
    told = tell(21, cameras=2, n=50, length_m=4.5, noise_mm=0.0)
    out = config.aggregator.out / "ledger.db"
    with Node("segmenter", "cam0", config=config, run="story") as node, loader(config) as ask:
        segmenters = Segmenters(node, told)
        wait_until(lambda: segmenters.all_acknowledged(0), what="the first acknowledgement", timeout_s=60)
        with Belt(segmenters) as belt, Observer(config.link, line="t") as observer:
            # Before any frame: the load begins with the run.
            first = ask("start", fields={"name": "A"})
            assert (first.done, first.load, first.place_x_m) == (True, 1, None)
            wait_until(lambda: belt.at_s > 4.0, what="4 s of belt")
            asked_s = belt.at_s
            second = ask("start", fields={"name": "B", "variety": "Agria"})
            assert second.place_x_m == pytest.approx(belt.place_m(asked_s), abs=NEAR_M)
            wait_until(
                lambda: (t := observer.totals()) and t.load and t.load.name == "B" and t.load.count > 0,
                what="the totals tell load B",
            )
            # kill -9 of the aggregator while an order is on its way: asked again under its id it is about that moment.
            request, answers = new_request(), []
            asker = threading.Thread(
                target=lambda: answers.append((belt.at_s, ask("start", request, fields={"name": "C"})))
            )
            asker.start()
            process.kill()
            process.start()
            asker.join(60)
            ((asked_s, third),) = answers
            assert (third.done, third.name) == (True, "C")
            assert third.place_x_m == pytest.approx(belt.place_m(asked_s), abs=NEAR_M)
            assert ask("start", request, fields={"name": "C"}) == third
            wrong = ask("ticket", load="A", kg=5000.0)
            assert (wrong.done, wrong.name) == (True, "A")
            assert "it is kept, but does not calibrate: the ticket says 5000.0 kg" in wrong.text
            assert "is below its net one, 5000.0 kg" in ask("ticket", load="A", kg=4000.0, net=False).text
            # kill -9 of the asker: what it asked for is done once, or not at all, and can be asked for again.
            args = [sys.executable, "-m", "tuberline", "load", "end", "--config", str(path), "--request", "end-1"]
            ending = subprocess.Popen(args, cwd=ROOT, stdout=subprocess.PIPE)
            ending.send_signal(signal.SIGKILL)
            ending.wait(20)
            assert ask("end", "end-1").load == third.load
            assert "no load is open" in ask("end").error
            wait_until(lambda: (t := observer.totals()) and t.load is None, what="no load in the totals")
        segmenters.deliver()
    code, said = process.end()
    assert code == 0, said
    assert check_file(out) == []
    found = sums_are_those_of_the_places(out)
    assert sum(found.values()) == len(told.seen())
    places = [first.place_x_m, second.place_x_m, third.place_x_m]
    assert found[1] == sum(t.x_m >= places[1] for t in told.seen())
    assert found[2] == sum(places[2] <= t.x_m < places[1] for t in told.seen())
    summary = json.loads((config.aggregator.out / "summary.json").read_text())
    assert {load["name"]: load["count"] for load in summary["loads"]} == {"A": found[1], "B": found[2], "C": found[3]}
    assert "load" not in summary["totals"], "none is open"
    with (config.aggregator.out / "tubers.csv").open(newline="") as file:
        assert Counter(int(row["load"]) for row in csv.DictReader(file)) == Counter(found)
    shown = subprocess.run(
        [sys.executable, "-m", "tuberline", "load", "show", "--ledger", str(out), "--json"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert {load["name"]: load["count"] for load in json.loads(shown.stdout)} == {
        "A": found[1],
        "B": found[2],
        "C": found[3],
    }


def test_an_order_that_cannot_be_read_is_refused_in_words(line: tuple[LineConfig, Path], process: Process) -> None:
    config, _ = line
    with open_client(config.link, name="loader") as session, Observer(config.link, line="t") as observer:
        wait_until(lambda: "aggregator/aggregator" in observer.alive(), what="the aggregator", timeout_s=60)
        replies = session.get("tuberline/t/order/load", payload=b"rubbish", timeout=10)
        (reply,) = [reply for reply in replies]  # noqa: C416
        assert reply.err is not None
        assert "message" in reply.err.payload.to_string()
        order = LoadOrder("x", "ticket", kg=500.0, by="test")
        assert "has no load yet" in send_order(session, "t", order).error
    process.popen.terminate()
    assert process.end()[0] == 0


def test_no_aggregator_is_said_in_words(link: LinkConfig) -> None:
    from conveyor.errors import LinkError

    with (
        open_client(link, name="loader") as session,
        pytest.raises(LinkError, match=r"is the aggregator of line 't' up"),
    ):
        send_order(session, "t", LoadOrder("x", "end"), within_s=1.0)


def test_a_refusal_that_is_no_text_is_one_all_the_same(link: LinkConfig) -> None:
    """What any peer may answer ended who asked with a UnicodeDecodeError."""
    from conveyor.errors import LinkError

    def refuse(query: zenoh.Query) -> None:
        query.reply_err(b"no \xff")
        query.drop()  # type: ignore[no-untyped-call, unused-ignore]

    with open_client(link, name="other") as other, Observer(link, line="t") as observer:
        for topic in (topics.ORDER_LOAD, topics.QUERY_LOADS):
            other.declare_queryable(topic.key("t"), zenoh.handlers.Callback(refuse, indirect=True))
        with pytest.raises(LinkError, match="the order is refused: no \ufffd"):
            send_order(observer.session, "t", LoadOrder("x", "end"), within_s=10.0)
        with pytest.raises(LinkError, match="loads: no \ufffd"):
            observer.query(topics.QUERY_LOADS, timeout_s=10.0)
