"""Live cameras that know nothing of the belt, and an encoder that does: through its faults every tuber counts once."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from aggregator.core.tubers import Tuber
from aggregator.ledger.writer import Ledger
from conveyor.config import LineConfig, dump_toml, parse_config
from conveyor.observer import Observer, observer_when_there
from tests.belts import simulate
from tests.conftest import wait_until
from tests.integration.encoder_device import METRES_PER_PULSE, EncoderBoard
from tuberline.processes import line_processes
from tuberline.replayer import free_port
from tuberline.supervisor import Supervisor

SPEED, STARTS_S = 0.3, 15.0
pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]


class LiveLine:
    """A line of live cameras that play `recording` without its travel, beside the board that counts it."""

    def __init__(self, folder: Path, recording: Path) -> None:
        self._folder = folder
        bare = shutil.copytree(recording, folder / "recording")
        self.cameras = sorted(table.parent.name for table in bare.glob("*/frames.csv"))
        for table in bare.glob("*/frames.csv"):
            head, *rows = table.read_text().splitlines()
            table.write_text("\n".join([head, *(row.rpartition(",")[0] + "," for row in rows)]) + "\n")
        starts_s = time.time() + STARTS_S
        self.board = EncoderBoard(recording / self.cameras[0] / "frames.csv", starts_s=starts_s, speed=SPEED)
        played = {"path": str(bare), "waits": False, "speed": SPEED, "starts_at_s": starts_s}
        source = {"source": f"tcp://127.0.0.1:{self.board.port}", "metres_per_pulse": METRES_PER_PULSE}
        self.config: LineConfig = parse_config(
            {
                "link": {"router": f"tcp/127.0.0.1:{free_port()}"},
                "cameras": {name: {**played, "camera": name} for name in self.cameras},
                "segmenter": {"state_dir": str(folder / "state"), "max_age_ms": 2000.0},
                "regressor": {"processes": 1, "state_dir": str(folder / "weights")},
                "aggregator": {"out": str(folder / "run"), "exit_when_final": True},
                "encoder": source,
            },
            where="of this test",
        )

    def run(self, *at: tuple[float, Callable[[Supervisor], None]]) -> Observer:
        """To its end; each of `at` is done when so much of the belt has passed."""
        file = self._folder / "line.toml"
        file.write_text(dump_toml(self.config))
        specs = line_processes(self.config, config_path=file, run="live")
        assert [spec.name for spec in specs].count("encoder") == 1
        with ExitStack() as stack:
            stack.enter_context(self.board)
            line = stack.enter_context(Supervisor(specs, log_dir=self._folder / "logs"))
            observer = stack.enter_context(
                observer_when_there(self.config.link, line=self.config.name, meanwhile=line.poll)
            )
            for share, act in at:
                self._wait_for(share, line)
                act(line)
            wait_until(lambda: line.poll() or line.finished("aggregator"), what="the summary", timeout_s=120)
            self.nodes = observer.nodes()
        return observer

    def _wait_for(self, share: float, line: Supervisor) -> None:
        wait_until(lambda: line.poll() or self.board.done >= share, what=f"{share:.0%} of the belt")

    @property
    def summary(self) -> dict[str, Any]:
        """As the aggregator left it."""
        found: dict[str, Any] = json.loads((self._folder / "run" / "summary.json").read_text())
        return found

    @property
    def tubers(self) -> list[Tuber]:
        """Of the ledger."""
        with Ledger(self._folder / "run" / "ledger.db") as ledger:
            return list(ledger.tubers("live"))

    def log(self, name: str) -> str:
        """What a process said."""
        return (self._folder / "logs" / f"{name}.log").read_text()


def truth(recording: Path) -> int:
    return len(json.loads((recording / "truth.json").read_text())["tubers"])


def kill(line: Supervisor, *names: str) -> None:
    """As power does."""
    for name in names:
        os.kill(line.pid(name) or 0, signal.SIGKILL)


def test_every_tuber_once_though_the_encoder_falls_silent_and_loses_its_count(recording: Path, tmp_path: Path) -> None:
    line = LiveLine(tmp_path, recording)

    def mute(_: Supervisor) -> None:
        line.board.mute = True

    def speak(_: Supervisor) -> None:
        line.board.mute = False

    line.run((0.25, mute), (0.4, speak), (0.6, lambda _: line.board.lose_count()))
    encoder = line.nodes["encoder/encoder"]
    cameras = [line.nodes[f"camera/{name}"] for name in line.cameras]
    segmenters = [line.nodes[f"segmenter/{name}"] for name in line.cameras]
    sys.stdout.write(f"{encoder.values} {[c.values for c in cameras]}\n")
    assert encoder.count("counts_lost") == 1
    assert all(c.count("frames_with_travel") > c.count("frames_without_travel") > 0 for c in cameras)
    assert {c.count("travel_dropped_overwritten") for c in cameras} == {0}
    assert all("the load tells the travel" in line.log(f"camera-{name}") for name in line.cameras)
    summary, tubers = line.summary, line.tubers
    dropped = sum(s.gauges.get(name, 0) for s in segmenters for name in s.gauges if name.startswith("frames_dropped"))
    assert summary["balanced"]
    assert len(tubers) <= truth(recording)
    if not dropped:  # a machine that is too slow says so
        assert len(tubers) == truth(recording)
        assert summary["coverage"] > 0.98, "the belt stood until its first frame: no clock, the encoder says so"
    assert sum(len(tuber.cameras) == 2 for tuber in tubers) >= 2
    assert not any("travel_estimated" in tuber.flags for tuber in tubers)


@pytest.mark.slow
@pytest.mark.parametrize("killed", ["encoder", "everything"])
def test_a_power_cut_counts_nothing_twice_and_goes_on_with_the_encoder(killed: str, tmp_path: Path) -> None:
    recording = simulate(tmp_path / "belt", scene="two-cameras", tubers="100")
    line = LiveLine(tmp_path, recording)
    names = ["encoder"]
    if killed == "everything":
        names += [f"{role}-{name}" for role in ("segmenter", "camera") for name in line.cameras]
    line.run((0.45, lambda processes: kill(processes, *names)))
    told = [float(m) for m in re.findall(r"tells travel from (\S+) m on", line.log("encoder"))]
    assert len(told) == 2
    assert told[0] == 0.0
    assert told[1] > 0.1, "where the load was"
    tubers, summary = line.tubers, line.summary
    assert len(tubers) <= truth(recording)
    assert not any("travel_estimated" in tuber.flags for tuber in tubers)
    if killed == "encoder":
        assert len(tubers) == truth(recording)
        assert sum(len(tuber.cameras) == 2 for tuber in tubers) >= 2
    else:
        assert 0 < len(tubers) < truth(recording)
        places_m = [t["place_x_m"] for t in json.loads((recording / "truth.json").read_text())["tubers"]]
        lost_m = (1 - len(tubers) / len(places_m)) * (max(places_m) - min(places_m))
        assert sum(summary["unseen_m"].values()) == pytest.approx(lost_m, abs=0.12)
