"""Hosts whose clocks differ, and step while the line runs: no age, no coverage and no total knows of it."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from aggregator.ledger.writer import Ledger
from benchmarks.belt_tables import without_travel
from conveyor.config import LineConfig, dump_toml, parse_config
from conveyor.observer import observer_when_there
from conveyor.taken_port import free_port
from tests.chaos.harness import DisturbedLine
from tuberline.processes import line_processes
from tuberline.supervisor import ProcessSpec, Supervisor

SOURCE = Path(__file__).parent / "clock" / "ahead.c"
COMPILER = shutil.which("cc")
SPEED, STARTS_S = 0.35, 20.0
pytestmark = [
    pytest.mark.graph,
    pytest.mark.timeout(300),
    pytest.mark.skipif(COMPILER is None, reason="a clock is faked by a library of a few lines: it needs a C compiler"),
]


class Clock:
    """The clock of a host, for the processes that are started inside the `with` block; it can be set at any time."""

    def __init__(self, folder: Path, *, ahead_s: float) -> None:
        self._file = folder / "ahead"
        self.set(ahead_s)
        library = folder / "ahead.so"
        subprocess.run([str(COMPILER), "-shared", "-fPIC", "-O1", "-o", str(library), str(SOURCE)], check=True)
        self._variables = {"LD_PRELOAD": str(library), "AHEAD_FILE": str(self._file)}

    def set(self, ahead_s: float) -> None:
        """It is `ahead_s` ahead of this machine's from now on."""
        part = self._file.with_suffix(".part")
        part.write_text(f"{ahead_s:+.3f}\n")
        part.replace(self._file)

    def __enter__(self) -> None:
        os.environ.update(self._variables)

    def __exit__(self, *_: object) -> None:
        for name in self._variables:
            del os.environ[name]


def a_line(folder: Path, recording: Path, starts_at_s: dict[str, float]) -> tuple[LineConfig, list[ProcessSpec]]:
    """A live line whose cameras all play the one camera of `recording`, each from a moment of its own host's clock."""
    played = {"path": str(recording), "camera": "front", "waits": False, "speed": SPEED}
    config = parse_config(
        {
            "link": {"router": f"tcp/127.0.0.1:{free_port()}"},
            "cameras": {name: {**played, "starts_at_s": at_s} for name, at_s in starts_at_s.items()},
            "segmenter": {"state_dir": str(folder / "state"), "max_age_ms": 2000.0},
            "regressor": {"processes": 1, "state_dir": str(folder / "weights")},
            "aggregator": {"out": str(folder / "run"), "exit_when_final": True},
        },
        where="of this test",
    )
    file = folder / "line.toml"
    file.write_text(dump_toml(config))
    return config, line_processes(config, config_path=file, run="hosts")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ahead_s", "steps_s"),
    [
        pytest.param(3600.0, (3598.0,), id="an-hour-ahead-then-2-s-back"),
        pytest.param(-2.0, (), id="2-s-behind"),
        pytest.param(0.0, (3600.0, -86400.0), id="an-hour-on-then-a-day-back"),
    ],
)
def test_a_camera_host_with_another_clock(
    ahead_s: float, steps_s: tuple[float, ...], live_recording: Path, tmp_path: Path
) -> None:
    """The camera says of itself what time its frames have: an hour more than its log's would be an hour of belt."""
    recording = without_travel(live_recording, tmp_path / "recording")
    config, specs = a_line(tmp_path, recording, {"front": time.time() + ahead_s + STARTS_S})
    there = [spec for spec in specs if spec.args[0] in ("camera", "segmenter")]
    clock = Clock(tmp_path, ahead_s=ahead_s)
    with ExitStack() as stack:
        here = stack.enter_context(Supervisor([s for s in specs if s not in there], log_dir=tmp_path / "logs"))
        with clock:
            host = stack.enter_context(Supervisor(there, log_dir=tmp_path / "logs"))
        observer = stack.enter_context(observer_when_there(config.link, line=config.name, meanwhile=here.poll))
        line = DisturbedLine(here, observer)
        for n, step_s in enumerate(steps_s):
            line.wait_count("frames_processed", 15 * (n + 1))
            clock.set(step_s)
        line.wait(lambda: line.count("clock_steps") >= len(steps_s), what="each step told")
        line.wait(lambda: here.finished("aggregator"), what="the summary", timeout_s=150)
        oldest_ms, steps = line.gauge("frame_age_max_ms"), line.count("clock_steps")
        assert {*host.restarts.values(), *here.restarts.values()} == {0}
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    truth = json.loads((live_recording / "truth.json").read_text())
    (sheet,) = summary["cameras"].values()
    share = summary["totals"]["count"] / len(truth["tubers"])
    assert steps == len(steps_s)
    assert oldest_ms <= 2000.0
    assert sheet["frames"].get("dropped_too_old", 0) <= 0.1 * sheet["frames"]["published"]
    assert summary["balanced"]
    assert summary["belt_m"] < 10.0, "an hour of belt that never ran"
    assert sheet["unseen_m"].pop("before_first_frame") > 0, "the line had begun before its camera"
    assert sum(sheet["unseen_m"].values()) / summary["belt_m"] == pytest.approx(1 - share, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("ahead_s", [-2.0, 3600.0])
def test_two_camera_hosts_whose_clocks_differ(ahead_s: float, live_recording: Path, tmp_path: Path) -> None:
    """Two cameras see the same belt: laid side by side by clocks 2 s apart, every tuber would be two."""
    recording = without_travel(live_recording, tmp_path / "recording")
    starts_s = time.time() + STARTS_S
    config, specs = a_line(tmp_path, recording, {"front": starts_s, "other": starts_s + ahead_s})
    there = [spec for spec in specs if spec.name in ("camera-other", "segmenter-other")]
    assert len(there) == 2
    with ExitStack() as stack:
        here = stack.enter_context(Supervisor([s for s in specs if s not in there], log_dir=tmp_path / "logs"))
        with Clock(tmp_path, ahead_s=ahead_s):
            host = stack.enter_context(Supervisor(there, log_dir=tmp_path / "logs"))
        observer = stack.enter_context(observer_when_there(config.link, line=config.name, meanwhile=here.poll))
        line = DisturbedLine(here, observer)
        line.wait(lambda: here.finished("aggregator"), what="the summary", timeout_s=200)
        assert {*host.restarts.values(), *here.restarts.values()} == {0}
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    true = len(json.loads((live_recording / "truth.json").read_text())["tubers"])
    with Ledger(tmp_path / "run" / "ledger.db") as ledger:
        tubers = list(ledger.tubers("hosts"))
    by_both = sum(len(tuber.cameras) == 2 for tuber in tubers)
    told = re.findall(
        r"the clock of camera other on another is (\S+) s off", (tmp_path / "logs/aggregator.log").read_text()
    )
    assert [float(s) for s in told] == [pytest.approx(ahead_s, abs=0.4)]
    assert summary["balanced"]
    assert len(tubers) <= true + 2, f"{len(tubers)} tubers of {true}, {by_both} seen by both"
    assert by_both >= 0.8 * len(tubers) > 0
    assert summary["belt_m"] < 10.0
