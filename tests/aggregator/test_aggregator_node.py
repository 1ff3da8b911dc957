"""The aggregator's process over a real router: acknowledgements, kill -9 in the middle, answers, summary."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from aggregator.ledger.writer import Ledger
from aggregator.node import AggregatorNode
from aggregator.opening import keep_config, open_run
from conveyor import __version__, topics
from conveyor.config import LineConfig, LinkConfig, dump_toml, load_config, parse_config
from conveyor.delivery.kept import KeptPublisher, KeptSubscriber
from conveyor.delivery.reliable import ReliablePublisher, ReliableSubscriber
from conveyor.geometry import Intrinsics
from conveyor.messages import CameraInfo, Committed, Counters, TrackEntry, Tuber
from conveyor.node import Node
from conveyor.observer import Observer
from conveyor.wire import pack, unpack
from tests.aggregator.belt_story import CLOCK_S, Story, tell
from tests.conftest import ROOT, start_router, wait_until

pytestmark = [pytest.mark.graph, pytest.mark.timeout(120)]


@pytest.fixture
def line(link: LinkConfig, tmp_path: Path) -> tuple[LineConfig, Path]:
    """A line with two cameras, and its TOML file."""
    config = parse_config(
        {
            "name": "t",
            "link": {"router": link.router},
            "cameras": {"cam0": {"path": "x"}, "cam1": {"path": "x"}},
            "aggregator": {"out": str(tmp_path / "out"), "exit_when_final": True},
        },
        where="test",
    )
    path = tmp_path / "line.toml"
    path.write_text(dump_toml(config))
    return config, path


class Process:
    """`tuberline aggregator` as its own process, to be killed and started again."""

    def __init__(self, config: Path) -> None:
        self._args = [sys.executable, "-m", "tuberline", "aggregator", "--config", str(config), "--run", "story"]
        self.start()

    def start(self) -> None:
        self.popen = subprocess.Popen(self._args, cwd=ROOT, stderr=subprocess.PIPE, text=True)

    def kill(self) -> None:
        self.popen.kill()
        self.popen.communicate(timeout=20)

    def end(self) -> tuple[int, str]:
        _, said = self.popen.communicate(timeout=40)
        return self.popen.returncode, said


@pytest.fixture
def process(line: tuple[LineConfig, Path]) -> Iterator[Process]:
    running = Process(line[1])
    yield running
    if running.popen.poll() is None:
        running.kill()


class Segmenters:
    """Both cameras' segmenters: they keep what is not acknowledged and send it again."""

    def __init__(self, node: Node, told: Story) -> None:
        self.told = told
        self._out = {name: ReliablePublisher(node, topics.TRACK, camera=name) for name in told.names}
        self._committed = KeptSubscriber(node, topics.COMMITTED, Committed, camera="*")

    def acknowledged(self, camera: str) -> int:
        found = [c.n for c in self._committed.latest().values() if c.camera == camera and c.run == self.told.run]
        return max(found, default=-1)

    def send(self, upto: int | None = None) -> None:
        for camera, out in self._out.items():
            for entry in self.told.logs[camera][max(0, self.acknowledged(camera)) : upto]:
                out.put(entry)

    def deliver(self, upto: int | None = None) -> None:
        """Send entries, and again every second, until they are acknowledged."""
        sent_s = float("-inf")

        def acknowledged() -> bool:
            nonlocal sent_s
            if time.monotonic() - sent_s > 1.0:
                sent_s = time.monotonic()
                self.send(upto)
            return self.all_acknowledged(upto)

        wait_until(acknowledged, what=f"entries up to {upto} acknowledged", timeout_s=40)

    def all_acknowledged(self, upto: int | None = None) -> bool:
        return all(self.acknowledged(camera) >= len(log[:upto]) for camera, log in self.told.logs.items())


def test_killed_in_the_middle_it_counts_everything_once(line: tuple[LineConfig, Path], process: Process) -> None:
    config, _ = line
    told = tell(12, cameras=2, n=20, length_m=1.5)
    with Node("segmenter", "cam0", config=config, run="story") as node:
        segmenters = Segmenters(node, told)
        tubers = ReliableSubscriber(node, topics.TUBER, Tuber)
        wait_until(lambda: segmenters.all_acknowledged(0), what="the first acknowledgement", timeout_s=40)
        segmenters.deliver(14)
        process.kill()
        segmenters.send(18)
        process.start()
        with Observer(config.link, line="t") as observer:
            wait_until(lambda: "aggregator/aggregator" in observer.alive(), what="the second process", timeout_s=40)
            segmenters.deliver(18)
            answered: dict[str, Any] = observer.query(topics.QUERY_TOTALS)
            first = observer.query(topics.QUERY_TUBERS, parameters="limit=3")
            assert [tuber["tuber_id"] for tuber in first] == [1, 2, 3][: answered["count"]]
            rest = observer.query(topics.QUERY_TUBERS, parameters="since=1")
            assert all(tuber["tuber_id"] > 1 for tuber in rest)
            with pytest.raises(Exception, match="limit=many: give a whole number"):
                observer.query(topics.QUERY_TUBERS, parameters="limit=many")
            with pytest.raises(Exception, match="since=99999999999999999999: give a whole number"):
                observer.query(topics.QUERY_TUBERS, parameters=f"since={'9' * 5000}")
            segmenters.deliver()
            wait_until(lambda: (totals := observer.totals()) and totals.final, what="final totals")
    code, said = process.end()
    assert code == 0, said
    summary = json.loads((config.aggregator.out / "summary.json").read_text())
    assert summary["balanced"] is True
    assert summary["final"] is True
    assert summary["totals"]["count"] == len(told.seen())
    assert summary["totals"]["coverage"] == 1.0
    with (config.aggregator.out / "tubers.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == len(told.seen())
    published = {tuber.tuber_id for tuber in iter(lambda: tubers.get(0.0), None)}
    assert published <= set(range(1, len(told.seen()) + 1))


def test_the_config_stands_beside_the_ledger_and_no_file_of_a_person_is_replaced(tmp_path: Path) -> None:
    """A live line's report found no contract, and its map no working width: only a replay had its config there."""
    gnss = {"source": "simulated:", "width_m": 3.0}
    raw = {"name": "t", "aggregator": {"out": str(tmp_path / "out")}, "gnss": gnss}
    (tmp_path / "out").mkdir()
    for width_m in (3.0, 1.5):
        gnss["width_m"] = width_m
        keep_config(parse_config(raw, where="test"))
        kept = load_config(tmp_path / "out" / "line.toml")
        assert kept.gnss is not None
        assert kept.gnss.width_m == width_m
    (tmp_path / "out" / "line.toml").write_text("# mine\n")
    keep_config(parse_config(raw, where="test"))
    assert (tmp_path / "out" / "line.toml").read_text() == "# mine\n"


def test_a_finished_run_is_refused_in_words(line: tuple[LineConfig, Path], process: Process) -> None:
    config, _ = line
    told = tell(13, cameras=2, n=4)
    with Node("segmenter", "cam0", config=config, run="story") as node:
        segmenters = Segmenters(node, told)
        wait_until(lambda: segmenters.all_acknowledged(0), what="the first acknowledgement", timeout_s=40)
        segmenters.deliver()
    assert process.end()[0] == 0
    process.start()
    code, said = process.end()
    assert code == 2
    assert "already holds run 'story', finished" in said
    assert "Traceback" not in said


def test_stopped_early_it_says_what_it_has(line: tuple[LineConfig, Path], process: Process) -> None:
    config, _ = line
    told = tell(14, cameras=2, n=10)
    with Node("segmenter", "cam0", config=config, run="story") as node:
        segmenters = Segmenters(node, told)
        wait_until(lambda: segmenters.all_acknowledged(0), what="the first acknowledgement", timeout_s=40)
        segmenters.deliver(12)
    process.popen.terminate()
    assert process.end()[0] == 0
    summary = json.loads((config.aggregator.out / "summary.json").read_text())
    assert summary["final"] is False
    assert summary["tracks"]["pending"] >= 0
    audited = subprocess.run(
        [sys.executable, "-m", "tuberline", "audit", str(config.aggregator.out), "--json"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert audited.returncode == 0, audited.stdout
    told = json.loads(audited.stdout)
    assert (told["finished"], told["end"]) == (False, "stopped")


def test_a_node_of_another_version_is_told_and_stands_in_the_summary(
    line: tuple[LineConfig, Path], process: Process
) -> None:
    config, _ = line
    old = Counters("regressor", "barn", "story", 7, "barn-pc", "0.0.9", 1.0, {}, {})
    with Node("observer", "watch", config=config, run="story") as node, Observer(config.link, line="t") as observer:
        reports = KeptPublisher(node, topics.COUNTERS, role="regressor", name="barn")
        wait_until(lambda: "aggregator/aggregator" in observer.alive(), what="the aggregator", timeout_s=40)
        summary = config.aggregator.out / "summary.json"

        assert process.popen.stderr is not None
        reports.put(old)
        words = next(text for text in process.popen.stderr if "0.0.9" in text)
        assert f"regressor/barn on barn-pc runs tuberline 0.0.9, the ledger is kept by {__version__}" in words
    process.popen.terminate()
    assert process.end()[0] == 0
    found = json.loads(summary.read_text())
    assert found["software"] == __version__
    assert found["other_versions"]["regressor/barn"] == "0.0.9"


class Spoilt(TrackEntry):
    """An entry whose sender does not check what it sends: a tuber of 3 km."""

    def encode(self, *, codec: str = "raw") -> bytes:
        kind, fields, _ = unpack(TrackEntry(self.camera, self.run, self.n, track=self.track).encode())
        return pack(kind, {**fields, "track": {**fields["track"], "length_mm": 3e6}}, {})


def test_an_entry_that_cannot_be_read_holds_nobody_up(line: tuple[LineConfig, Path], process: Process) -> None:
    """It is acknowledged, so it does not come forever; the summary says that it is lost, and the run ends."""
    config, _ = line
    told = tell(15, cameras=2, n=6)
    bad = next(entry for entry in told.logs["cam0"] if entry.track is not None)
    told.logs["cam0"][bad.n - 1] = Spoilt("cam0", bad.run, bad.n, track=bad.track)
    with Node("segmenter", "cam0", config=config, run="story") as node:
        segmenters = Segmenters(node, told)
        wait_until(lambda: segmenters.all_acknowledged(0), what="the first acknowledgement", timeout_s=40)
        segmenters.deliver()
    code, said = process.end()
    assert code == 0, said
    assert f"entry {bad.n} of cam0 is set aside" in said
    summary = json.loads((config.aggregator.out / "summary.json").read_text())
    assert summary["final"] is True
    assert summary["balanced"] is False
    assert summary["set_aside"] == {"cam0": 1}
    assert summary["aggregator"]["track_refused_range"] >= 1
    assert summary["aggregator"]["track_refused_from_cam0"] == summary["aggregator"]["track_refused"]
    assert any("entries that could not be read" in text for text in summary["differences"])


def test_nothing_seen_is_never_a_number(line: tuple[LineConfig, Path], process: Process) -> None:
    """A line whose segmenters were frozen for 40 s said '90 %: 0.0 to 0.0'."""
    config, _ = line
    with Observer(config.link, line="t") as observer:
        wait_until(lambda: (told := observer.totals()) and told.state == "starting", what="starting", timeout_s=40)
        told = observer.totals()
        assert told is not None
        assert told.reason == "no frame processed yet of cam0, cam1"
    process.popen.terminate()
    assert process.end()[0] == 0
    summary = json.loads((config.aggregator.out / "summary.json").read_text())
    assert (summary["state"], summary["reason"]) == ("nothing seen", "no camera was heard of")
    assert summary["totals"]["weight_g"] is summary["totals"]["low_g"] is summary["totals"]["estimated_high_g"] is None


def test_a_run_began_when_it_did_however_long_the_router_is_away(free_port: int, tmp_path: Path) -> None:
    """Killed while the router stood still for 12 s, it took the run for 10 s older, and coverage was 10 points low."""
    link = {"router": f"tcp/127.0.0.1:{free_port}"}
    cameras = {"cam0": {"path": "x"}}
    raw = {"name": "t", "link": link, "cameras": cameras, "aggregator": {"out": str(tmp_path)}}
    config = parse_config(raw, where="test")
    with Ledger(tmp_path / "ledger.db") as ledger:
        began_s = time.monotonic()
        open_run(ledger, "story", config=config, cameras=["cam0"], may_be_finished=True)
    routers = []
    late = threading.Timer(2.0, lambda: routers.append(start_router(link["router"])))
    late.start()
    try:
        with AggregatorNode(config, run="story") as node:
            assert time.monotonic() - began_s > 2.0
            assert node._core.cameras._began_s == pytest.approx(began_s, abs=0.5)
    finally:
        late.join()
        for router in routers:
            router.terminate()
            router.wait(30)


FIRST_S = CLOCK_S + 0.5 - 2.0
"""The cameras publish from 2 s before the first frame that is looked at."""


def camera_info(camera: str, *, first_s: float, last_s: float) -> CameraInfo:
    """A camera without an encoder that published from and to these seconds of its clock."""
    lens = Intrinsics(10, 10, 10.0, 10.0, 5.0, 5.0)
    return CameraInfo(
        camera, "story", "streaming", "test", 30.0, False, lens, 0.001, 0, 299, 300, {},
        first_captured_ns=round(first_s * 1e9), last_captured_ns=round(last_s * 1e9),
    )  # fmt: skip


def test_belt_that_passed_before_the_segmenters_looked_is_told(line: tuple[LineConfig, Path], process: Process) -> None:
    """A line that took 8 s to start counted 52 of 61 tubers, and said that it had seen all of the belt."""
    config, _ = line
    told = tell(15, cameras=2, n=10, estimated=True)
    ends_s = {name: told.logs[name][-1].mark.captured_ns / 1e9 for name in told.names}  # type: ignore[union-attr]
    with Node("segmenter", "cam0", config=config, run="story") as node:
        infos = {name: KeptPublisher(node, topics.CAMERA_INFO, camera=name) for name in told.names}
        for name, out in infos.items():
            out.put(camera_info(name, first_s=FIRST_S, last_s=ends_s[name]))
        segmenters = Segmenters(node, told)
        wait_until(lambda: segmenters.all_acknowledged(0), what="the first acknowledgement", timeout_s=40)
        segmenters.deliver()
        assert process.end()[0] == 0
    summary = json.loads((config.aggregator.out / "summary.json").read_text())
    belt_m = 0.3 * (ends_s["cam0"] - FIRST_S)
    assert summary["state"] == "ended"
    assert summary["belt_m"] == pytest.approx(belt_m, rel=0.1)
    before_m = summary["unseen_m"]["before_first_frame"]
    assert before_m == pytest.approx(0.3 * 2.0 - 0.15, rel=0.1)
    assert summary["coverage"] == pytest.approx(1 - before_m / summary["belt_m"], abs=0.02)
    assert summary["totals"]["estimated_weight_g"] > summary["totals"]["weight_g"]
