"""Positions of a recording, on their topic again at the times of its frames."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from camera_sim.gnss.recorded import ALL, MOST_AT_ONCE, due, reached_ns, recorded_positions
from conveyor import topics
from conveyor.config import LineConfig, LinkConfig, load_config
from conveyor.delivery import KeptPublisher, ReliableSubscriber
from conveyor.errors import InputError
from conveyor.formats import open_source
from conveyor.formats.beside import positions_beside
from conveyor.formats.conversion import convert_recording
from conveyor.formats.positions import POSITIONS_FILE, PositionsWriter
from conveyor.messages import CameraInfo, Frame, Position
from conveyor.observer import Observer
from tests.camera_sim.camera_process import RUN, process
from tests.conftest import wait_until
from tests.viewer.viewer_line import camera_info

START_NS = 1_789_380_000 * 10**9


def positions(count: int, *, step_s: float = 1.0, start_ns: int = START_NS) -> list[Position]:
    """A machine that drives north, without a fix at its third second."""
    return [
        Position("gnss", RUN, n, start_ns + round(n * step_s * 1e9), start_ns - 3 + n, 52.7 + n * 1e-5, 5.75,
                 0 if n == 2 else 4, None if n == 2 else 0.7, 14)
        for n in range(count)
    ]  # fmt: skip


def written(path: Path, rows: list[Position]) -> Path:
    with PositionsWriter(path) as file:
        for at in rows:
            file.add(at)
    return path


def said(camera: str, at_ns: int | None, *, state: str = "streaming", run: str = RUN) -> CameraInfo:
    return replace(camera_info(run=run, camera=camera), state=state, last_captured_ns=at_ns)


def test_the_camera_that_is_furthest_behind_says_how_far_the_recording_is() -> None:
    both = ["front", "rear"]
    assert reached_ns({"a": said("front", 7)}, cameras=both, run=RUN) is None, "the other has said nothing"
    assert reached_ns({"a": said("front", 7), "b": said("rear", None)}, cameras=both, run=RUN) is None
    assert reached_ns({"a": said("front", 7), "b": said("rear", 5)}, cameras=both, run=RUN) == 5
    assert reached_ns({"a": said("front", 7), "b": said("rear", 5, run="old")}, cameras=both, run=RUN) is None
    ended = said("rear", 5, state="ended")
    assert reached_ns({"a": said("front", 7), "b": ended}, cameras=both, run=RUN) == 7
    assert reached_ns({"a": replace(ended, camera="front"), "b": ended}, cameras=both, run=RUN) == ALL


def test_positions_are_due_in_their_order_and_not_all_at_once() -> None:
    rows = positions(200)
    assert due(rows, 0, None) == ()
    assert due(rows, 0, START_NS - 1) == []
    assert due(rows, 1, START_NS + 3 * 10**9) == rows[1:4]
    assert due(rows, 0, ALL) == rows[:MOST_AT_ONCE]
    assert due(rows, 195, ALL) == rows[195:]
    jumped = [rows[0], replace(rows[1], time_ns=START_NS * 2), rows[2]]
    assert due(jumped, 0, START_NS + 10**10) == rows[:1], "a time ahead holds back what came after it"
    assert due(jumped, 1, ALL) == jumped[1:]


def test_rows_come_back_as_they_were_told(tmp_path: Path) -> None:
    rows = positions(4)
    assert recorded_positions(written(tmp_path / POSITIONS_FILE, rows), run=RUN) == rows
    (tmp_path / "other.csv").write_text("time,lat,lon\n1789380000,52.7,5.75\n")
    (one,) = recorded_positions(tmp_path / "other.csv", run=RUN)
    assert (one.time_ns, one.fix_ns, one.quality, one.hdop) == (START_NS, START_NS, 1, None)
    (tmp_path / "far.csv").write_text("time,lat,lon\n1789380000,152.7,5.75\n")
    with pytest.raises(InputError, match=r"far\.csv, line 2: its latitude is 152\.7"):
        recorded_positions(tmp_path / "far.csv", run=RUN)


@pytest.mark.graph
def test_a_replay_tells_positions_with_its_frames_and_again_when_its_process_starts_again(
    link: LinkConfig, tmp_path: Path
) -> None:
    config = LineConfig.model_validate({"link": link, "aggregator": {"out": tmp_path}, "cameras": {"front": {}}})
    rows = positions(120)
    written(tmp_path / POSITIONS_FILE, rows)
    with Observer(link, line=config.name) as observer:
        heard = ReliableSubscriber(observer, topics.POSITION, Position, receiver="*")
        camera = KeptPublisher(observer, topics.CAMERA_INFO, camera="front")
        got: list[Position] = []

        def arrived(count: int) -> bool:
            while (at := heard.get(0.05)) is not None:
                got.append(at)
            return len(got) >= count

        with process(config, tmp_path, "gnss", "--recorded") as node:
            wait_until(lambda: "gnss/gnss" in observer.alive(), what="its process")
            camera.put(said("front", START_NS + 4 * 10**9))
            wait_until(lambda: arrived(5), what="five positions")
            node.kill()
        with process(config, tmp_path, "gnss", "--recorded") as node:
            wait_until(lambda: arrived(10), what="the same five again")
            assert got == [*rows[:5], *rows[:5]]
            camera.put(said("front", START_NS + 5 * 10**9, state="ended"))
            wait_until(lambda: arrived(125), what="the others")
            node.send_signal(signal.SIGTERM)
            assert node.wait(30) == 0
        assert got[5:] == rows


@pytest.mark.slow
@pytest.mark.graph
def test_a_recorder_on_a_replay_writes_the_positions_of_the_recording(recording: Path, tmp_path: Path) -> None:
    """Real processes throughout: the second recording's positions are those of the first, byte for byte, though the
    process that tells them is killed in the middle; and so are those beside the replayed ledger.
    """
    source, out, again = tmp_path / "first.mcap", tmp_path / "run", tmp_path / "again.mcap"
    convert_recording(recording, source)
    first_ns = next(
        item.captured_ns for item in open_source(source, camera="left").frames(run=RUN) if isinstance(item, Frame)
    )
    rows = positions(60, step_s=0.1, start_ns=first_ns - 3 * 10**8)
    track = written(positions_beside(source), rows).read_bytes()
    command = [sys.executable, "-m", "tuberline"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        [*command, "replay", str(source), "--out", str(out), "--speed", "0.5", "--regressors", "1"], env=environment
    ) as replay:
        try:
            wait_until((out / "run").is_file, what="the replay to begin", timeout_s=60)
            with subprocess.Popen(
                [*command, "recorder", "--config", str(out / "line.toml"), "--out", str(again)], env=environment
            ) as recorder:
                _kill_the_teller(out)
                assert replay.wait(170) == 0
                recorder.send_signal(signal.SIGTERM)
                assert recorder.wait(30) == 0
        finally:
            replay.kill()
    assert (out / POSITIONS_FILE).read_bytes() == track
    assert positions_beside(again).read_bytes() == track


def _kill_the_teller(out: Path) -> None:
    """Kill it when it has told ten."""
    config = load_config(out / "line.toml")
    with Observer(config.link, line=config.name) as observer:

        def told() -> int:
            counters = observer.nodes().get("gnss/gnss")
            return 0 if counters is None else counters.count("positions")

        wait_until(lambda: told() >= 10, what="ten positions", timeout_s=60)
        pid = next(c.pid for name, c in observer.nodes().items() if name == "gnss/gnss")
        os.kill(pid, signal.SIGKILL)
