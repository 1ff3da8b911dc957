"""`tuberline alarms` as a process on a real line: drift, coverage, a lost regressor; no network, kill -9, and back."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from conveyor import topics
from conveyor.config import LineConfig, LinkConfig, dump_toml, load_config
from conveyor.delivery import KeptPublisher
from conveyor.messages import Counters, Totals
from conveyor.node import Node
from tests.alarms.alarm_words import Receiver, receiving
from tests.conftest import wait_until
from tuberline.alarms.outbox import alarms_folder, is_in_use
from tuberline.doctor import Level
from tuberline.doctor.alarms import check_alarms
from tuberline.processes import line_processes


def alarms_config(link: LinkConfig, folder: Path, port: int) -> Path:
    """A line that has alarms, with short times."""
    file = folder / "line.toml"
    file.write_text(
        f'name = "north"\n[link]\nrouter = "{link.router}"\n[aggregator]\nout = "run"\n[alarms]\n'
        f'channels = ["http://127.0.0.1:{port}/alarms"]\nafter_s = 0.5\nclear_s = 1.0\nagain_after_s = 0.0\n'
    )
    return file


def start(file: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "tuberline", "alarms", str(file)])


def told(server: Receiver, key: str) -> list[dict[str, Any]]:
    return [taken for taken in server.taken if taken["key"] == key]


@pytest.mark.graph
def test_alarms_begin_and_end_once_over_an_outage_and_a_kill(link: LinkConfig, tmp_path: Path) -> None:
    with receiving() as server:
        port = server.port
        file = alarms_config(link, tmp_path, port)
        config = LineConfig(name="north", link=link)
        process = start(file)
        try:
            with Node("segmenter", "left", config=config, run="r") as segmenter:
                totals = KeptPublisher(segmenter, topics.TOTALS)
                with Node("regressor", "r1", config=config, run="r"):
                    segmenter.counters.gauge("belt_drift_mm", 9.0)
                    segmenter.counters.gauge("belt_alarm", 1.0)
                    totals.put(load(coverage=0.5))
                    wait_until(lambda: told(server, "camera-left-belt"), what="drift")
                    wait_until(lambda: told(server, "coverage-r"), what="coverage")
                wait_until(lambda: told(server, "regressor-r1-lost"), what="the regressor's loss")
                server.close()
                segmenter.counters.gauge("belt_alarm", 0.0)
                totals.put(load(coverage=1.0))
                wait_until(lambda: waiting(process, tmp_path), what="messages kept")
                process.send_signal(signal.SIGKILL)
                process.wait(30)
                process = start(file)
                with receiving(port) as back:
                    wait_until(lambda: told(back, "camera-left-belt"), what="the drift's end")
                    wait_until(lambda: told(back, "coverage-r"), what="the coverage's end")
                    totals.put(load(coverage=0.5))  # begins again after a while in which nothing else may end
                    wait_until(lambda: len(told(back, "coverage-r")) == 2, what="the coverage once more")
                    assert told(back, "regressor-r1-lost") == [], "who never saw it cannot say that it is back"
                    with Node("regressor", "r1", config=config, run="r"):
                        wait_until(lambda: told(back, "regressor-r1-lost"), what="the regressor's return")
                        everything = server.taken + back.taken
        finally:
            process.terminate()
            assert process.wait(30) == 0
    drift = [m for m in everything if m["key"] == "camera-left-belt"]
    assert [m["event"] for m in drift] == ["begin", "end"]
    assert drift[0]["alarm"] == drift[1]["alarm"]
    assert drift[0]["camera"] == "left"
    assert "9 mm further than calibrated" in drift[0]["text"]
    assert drift[0]["fix"]
    assert [m["event"] for m in everything if m["key"] == "coverage-r"] == ["begin", "end", "begin"]
    assert [m["event"] for m in everything if m["key"] == "regressor-r1-lost"] == ["begin", "end"]
    assert not [m["key"] for m in everything if m["key"].endswith("-quiet")], "who has just come is not silent"
    assert len({m["id"] for m in everything}) == len(everything)


def waiting(process: subprocess.Popen[bytes], folder: Path) -> bool:
    """Both ends are kept in the outbox's file or its log: nothing else can be read while the process has it."""
    assert process.poll() is None
    wal = b"".join(path.read_bytes() for path in (folder / "run" / "alarms").glob("alarms.db*"))
    return wal.count(b"-end") >= 2


def load(*, coverage: float) -> Totals:
    return Totals(
        run="r",
        count=100,
        weight_g=17000.0,
        low_g=16000.0,
        high_g=18000.0,
        coverage=coverage,
        estimated_weight_g=17000.0,
        estimated_low_g=16000.0,
        estimated_high_g=18000.0,
        tubers_per_s=3.0,
        histogram_step_g=50.0,
        histogram=(100,),
        cameras={"left": "running"},
        final=False,
    )


@pytest.mark.graph
def test_the_doctor_says_whether_somebody_sends_them(link: LinkConfig, tmp_path: Path) -> None:
    """A line whose file has alarms and that was started without their sender told so nowhere."""
    config = load_config(alarms_config(link, tmp_path, 80))
    folder = alarms_folder(config)

    def levels(host: str = socket.gethostname()) -> list[Level]:
        ledger = Counters(
            "aggregator", "aggregator", "r", 1, host=host, version="", status="ok", uptime_s=1.0, values={}, gauges={}
        )
        return [
            f.level for f in check_alarms(config, {"aggregator/aggregator": ledger}, alive={"aggregator/aggregator"})
        ]

    assert levels() == [Level.WARNING]
    process = start(tmp_path / "line.toml")
    try:
        wait_until(lambda: is_in_use(folder) is True, what="the sender's file")
        assert levels() == [Level.OK]
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait(30)
    assert is_in_use(folder) is False
    assert levels() == [Level.WARNING]
    assert levels(host="of the camera") == [], "they are sent where the ledger is"
    assert check_alarms(config, {}, alive=set()) == []
    (folder / "alarms.db").write_bytes(b"no database" * 99)
    assert is_in_use(folder) is None
    assert levels() == []


def test_run_starts_the_alarms_of_a_line_that_has_some(tmp_path: Path) -> None:
    file = alarms_config(LinkConfig(), tmp_path, 80)
    config = load_config(file)
    specs = line_processes(config, config_path=file, run="r")
    assert specs[-1].args == ("alarms", "--config", str(file))
    assert {s.config for s in specs} == {file}, "what gave up is started again when its file is corrected"
    assert "alarms" not in [s.name for s in line_processes(LineConfig(), config_path=file, run="r")]
    (tmp_path / "again.toml").write_text(dump_toml(config))
    assert load_config(tmp_path / "again.toml") == config
