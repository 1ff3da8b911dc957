"""Runs the whole graph on a recording while something goes wrong, and compares the ledger with the undisturbed one."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from conveyor.config import LineConfig, dump_toml
from conveyor.observer import Observer
from tests.belts import here
from tuberline.processes import line_processes
from tuberline.replayer import fingerprint, prepare_out, recording_cameras, replay_config
from tuberline.supervisor import ProcessSpec, Supervisor

STARTS = "starts_at_s = "
RAISING = Path(__file__).parent / "raising"
Disturbance = Callable[["DisturbedLine"], None]


class DisturbedLine:
    """A line at work, with handles to hurt it."""

    def __init__(self, supervisor: Supervisor, observer: Observer) -> None:
        self.supervisor = supervisor
        self.observer = observer
        self.watched = [supervisor]
        self._later = ExitStack()

    def poll(self) -> None:
        """Look after all processes once."""
        for supervisor in self.watched:
            supervisor.poll()

    def count(self, name: str) -> int:
        """Sum of a counter over all nodes, as last reported."""
        return sum(node.count(name) for node in self.observer.nodes().values())

    def gauge(self, name: str) -> float:
        """The largest level of that name over all nodes, as last reported."""
        return max((node.gauges.get(name, 0.0) for node in self.observer.nodes().values()), default=0.0)

    def wait(self, true: Callable[[], object], *, what: str, timeout_s: float = 60.0) -> None:
        """Keep the line supervised until `true()`; fails after the deadline."""
        deadline = time.monotonic() + timeout_s
        while not true():
            if time.monotonic() > deadline:
                pytest.fail(f"waited {timeout_s:g} s in vain for: {what}")
            self.poll()
            time.sleep(0.02)

    def wait_count(self, name: str, at_least: int) -> None:
        """Until the counter `name` reached `at_least`, over all nodes."""
        self.wait(lambda: self.count(name) >= at_least, what=f"{name} >= {at_least}", timeout_s=120.0)

    def wait_applied(self) -> None:
        """Until the aggregator that runs now, and not one before it, has applied an entry."""

        def applied() -> bool:
            pid = self.pid("aggregator")
            return any(node.pid == pid and node.count("entries_applied") for node in self.observer.nodes().values())

        self.wait(applied, what="an entry applied by this aggregator", timeout_s=120.0)

    def go_on(self, seconds: float) -> None:
        """Keep the line supervised for a while."""
        until = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() > until, what="the end of a pause", timeout_s=seconds + 30)

    def pid(self, process: str) -> int:
        """Process id of one of the line's processes."""
        pids = [pid for supervisor in self.watched if (pid := supervisor.pid(process)) is not None]
        assert pids, f"{process} does not run"
        return pids[0]

    def signal(self, process: str, number: signal.Signals) -> None:
        """Send a signal to one of the line's processes."""
        with suppress(ProcessLookupError):
            os.kill(self.pid(process), number)

    def restart(self, spec: ProcessSpec, *, after_s: float) -> None:
        """SIGTERM, wait until it left, and start it again after a while, as the restart of its unit does. It must be
        alone in its supervisor, which starts what somebody else ended.
        """
        sys.stdout.write(f"restart {spec.name}\n")
        (before,) = (s for s in self.watched if spec.name in s.restarts)
        assert list(before.restarts) == [spec.name]
        before.stop()
        self.watched.remove(before)
        self.go_on(after_s)
        self.watched.append(self._later.enter_context(Supervisor([spec])))

    def close(self) -> None:
        """Stop what was started on the way."""
        self._later.close()

    def kill(self, process: str) -> None:
        """SIGKILL, and wait until the supervisor has started it again."""
        supervisor = next(s for s in self.watched if process in s.restarts)
        before = supervisor.restarts[process]
        sys.stdout.write(f"kill -9 {process}\n")
        self.signal(process, signal.SIGKILL)
        self.wait(lambda: supervisor.restarts[process] > before, what=f"restart of {process}")

    def freeze(self, process: str, seconds: float) -> None:
        """SIGSTOP, and SIGCONT after `seconds`; the rest of the line stays supervised."""
        sys.stdout.write(f"freeze {process} for {seconds:g} s\n")
        self.signal(process, signal.SIGSTOP)
        self.go_on(seconds)
        self.signal(process, signal.SIGCONT)


@dataclass(frozen=True, slots=True)
class Site:
    """A line ready to be started: its config, where that is written, and all its processes."""

    config: LineConfig
    out: Path
    specs: list[ProcessSpec]

    def parts(self, *roles: str) -> list[ProcessSpec]:
        """The processes of some roles."""
        return [spec for spec in self.specs if spec.args[0] in roles]


def site(
    recording: Path,
    out: Path,
    *,
    speed: float = 1.0,
    regressors: int = 2,
    rrd: Path | None = None,
    settings: dict[str, Any] | None = None,
) -> Site:
    """A line that will replay `recording` into `out`."""
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
    return Site(config, out, line_processes(config, config_path=config_path, run=f"replay-{fingerprint(recording)}"))


@contextmanager
def started(line_site: Site) -> Iterator[DisturbedLine]:
    """The line at work, cameras included."""
    with (
        Supervisor(line_site.specs, log_dir=line_site.out / "logs") as supervisor,
        Observer(line_site.config.link, line=line_site.config.name) as observer,
    ):
        yield DisturbedLine(supervisor, observer)


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
    line_site = site(recording, out, speed=speed, regressors=regressors, rrd=rrd, settings=settings)
    with started(line_site) as line:
        disturb(line)
        line.wait(lambda: line.supervisor.finished("aggregator"), what="the summary", timeout_s=timeout_s)
        restarts = line.supervisor.restarts
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return {**summary, "restarts": restarts}


def live_run(
    recording: Path,
    out: Path,
    disturb: Disturbance,
    *,
    speed: float = 1.0,
    regressors: int = 2,
    settings: dict[str, Any] | None = None,
    by_the_clock: bool = False,
    timeout_s: float = 150.0,
) -> dict[str, Any]:
    """Like `disturbed_replay`, with cameras that wait for no one and start when everybody else is there.

    `by_the_clock`: what a camera's process does not take in time is gone, as with a device.
    """
    names = recording_cameras(recording)
    camera: dict[str, Any] = {"path": str(recording.resolve()), "speed": speed, "waits": False}
    if by_the_clock:
        camera["starts_at_s"] = 1.0  # set when the cameras are started; no one else asks for it
    cameras = dict.fromkeys(names, camera)
    line_site = site(recording, out, regressors=regressors, settings={**(settings or {}), "cameras": cameras})
    others = line_site.parts("router", "aggregator", "regressor", "segmenter")
    with (
        Supervisor(others, log_dir=out / "logs") as supervisor,
        Observer(line_site.config.link, line=line_site.config.name) as observer,
    ):
        line = DisturbedLine(supervisor, observer)
        ready = {f"segmenter/{name}" for name in names} | {f"regressor/r{n}" for n in range(1, regressors + 1)}
        line.wait(lambda: ready <= observer.alive(), what=f"{sorted(ready)}", timeout_s=150)
        if by_the_clock:
            config = (out / "line.toml").read_text()
            (out / "line.toml").write_text(config.replace(f"{STARTS}1.0", f"{STARTS}{time.time() + 0.5}"))
        with Supervisor(line_site.parts("camera"), log_dir=out / "logs") as sources, closing(line):
            line.watched.append(sources)
            disturb(line)
            line.wait(lambda: supervisor.finished("aggregator"), what="the summary", timeout_s=timeout_s)
        restarts = supervisor.restarts
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return {**summary, "restarts": restarts}


@cache
def canonical(out: Path) -> str:
    """The canonical export of a finished run's ledger; asked for once."""
    return here("ledger", "export", out / "ledger.db", "--canonical").stdout


def inject(faults: Sequence[str], folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """From here on processes raise; the folder remembers what was raised."""
    raised = folder / "raised"
    raised.mkdir()
    monkeypatch.setenv("TUBERLINE_RAISE", "\n".join(faults))
    monkeypatch.setenv("TUBERLINE_RAISED", str(raised))
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(RAISING), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    )
    return raised
