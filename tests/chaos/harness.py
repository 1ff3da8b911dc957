"""Runs the whole graph on a recording while something goes wrong, and compares the ledger with the undisturbed one."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from conveyor.cli.replay import fingerprint, prepare_out, recording_cameras, replay_config
from conveyor.config import dump_toml
from conveyor.observer import Observer
from conveyor.processes import line_processes
from conveyor.supervisor import Supervisor
from tests.integration.conftest import tuberline

Disturbance = Callable[["DisturbedLine"], None]


class DisturbedLine:
    """A line at work, with handles to hurt it."""

    def __init__(self, supervisor: Supervisor, observer: Observer) -> None:
        self.supervisor = supervisor
        self.observer = observer

    def count(self, name: str) -> int:
        """Sum of a counter over all nodes, as last reported."""
        return sum(node.count(name) for node in self.observer.nodes().values())

    def wait(self, true: Callable[[], object], *, what: str, timeout_s: float = 60.0) -> None:
        """Keep the line supervised until `true()`; fails after the deadline."""
        deadline = time.monotonic() + timeout_s
        while not true():
            if time.monotonic() > deadline:
                pytest.fail(f"waited {timeout_s:g} s in vain for: {what}")
            self.supervisor.poll()
            time.sleep(0.02)

    def wait_count(self, name: str, at_least: int) -> None:
        """Until the counter `name` reached `at_least`, over all nodes."""
        self.wait(lambda: self.count(name) >= at_least, what=f"{name} >= {at_least}")

    def signal(self, process: str, number: signal.Signals) -> None:
        """Send a signal to one of the line's processes."""
        pid = self.supervisor.pid(process)
        assert pid is not None, f"{process} does not run"
        with suppress(ProcessLookupError):
            os.kill(pid, number)

    def kill(self, process: str) -> None:
        """SIGKILL, and wait until the supervisor has started it again."""
        before = self.supervisor.restarts[process]
        sys.stdout.write(f"kill -9 {process}\n")
        self.signal(process, signal.SIGKILL)
        self.wait(lambda: self.supervisor.restarts[process] > before, what=f"restart of {process}")

    def freeze(self, process: str, seconds: float) -> None:
        """SIGSTOP, and SIGCONT after `seconds`; the rest of the line stays supervised."""
        sys.stdout.write(f"freeze {process} for {seconds:g} s\n")
        self.signal(process, signal.SIGSTOP)
        until = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() > until, what="the end of the freeze", timeout_s=seconds + 30)
        self.signal(process, signal.SIGCONT)


def disturbed_replay(
    recording: Path,
    out: Path,
    disturb: Disturbance,
    *,
    speed: float = 1.0,
    regressors: int = 2,
    rrd: Path | None = None,
    settings: dict[str, Any] | None = None,
    timeout_s: float = 150.0,
) -> dict[str, Any]:
    """Replay `recording` into `out` while `disturb` acts on it; returns the summary with 'restarts'."""
    prepare_out(out)
    config = replay_config(
        recording,
        recording_cameras(recording),
        out=out,
        speed=speed,
        weights=None,
        regressors=regressors,
        rrd=rrd,
        settings=settings,
    )
    config_path = out / "line.toml"
    config_path.write_text(dump_toml(config))
    specs = line_processes(config, config_path=config_path, run=f"replay-{fingerprint(recording)}")
    with (
        Supervisor(specs, log_dir=out / "logs") as supervisor,
        Observer(config.link, line=config.name) as observer,
    ):
        line = DisturbedLine(supervisor, observer)
        disturb(line)
        line.wait(lambda: supervisor.finished("aggregator"), what="the summary", timeout_s=timeout_s)
        restarts = supervisor.restarts
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return {**summary, "restarts": restarts}


def canonical(out: Path) -> str:
    """The canonical export of a run's ledger."""
    return tuberline("ledger", "export", out / "ledger.db", "--canonical").stdout
