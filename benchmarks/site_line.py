"""A line spread over the hosts of a site, from its start to its summary."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Self

from benchmarks.proc import cpu_s
from benchmarks.site_net import Network, Traffic
from benchmarks.site_share import CpuShare
from conveyor.config import dump_toml, parse_config
from conveyor.errors import TuberlineError
from tuberline.replayer import prepare_out

CAMERAS = ("left", "middle", "right")
LINE = "site"
RUN = "bench"
ROOT = Path(__file__).resolve().parents[1]
VIEWS_PER_TUBER = 8


class SiteLine:
    """The processes of one run. Inference hosts are in no configuration: each is told the router and its own name.

    Args:
        network: with a host `edge`, where the router runs.
        camera: settings of every camera that differ from the benchmark's: as fast as the line takes it.
        settings: further config sections by name, laid over the benchmark's.
    """

    def __init__(
        self,
        network: Network,
        recording: Path,
        out: Path,
        *,
        cameras: Sequence[str] = CAMERAS,
        camera: Mapping[str, Any] | None = None,
        settings: Mapping[str, Mapping[str, Any]] | None = None,
        protocol: str = "tcp",
    ) -> None:
        self.network = network
        self.out = out
        self._stack = ExitStack()
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._latest: dict[str, Any] = {"weights": 0, "alive": []}
        self.config = out / "line.toml"
        prepare_out(out)
        self.router = f"{protocol}/{network.address('edge')}:7447"
        frames = {"path": str(recording.resolve()), "speed": 0.0, **(camera or {})}
        raw: dict[str, Any] = {
            "name": LINE,
            "link": {"router": self.router, "connect_timeout_s": 60.0},
            "cameras": dict.fromkeys(cameras, frames),
            "segmenter": {
                "views_per_tuber": VIEWS_PER_TUBER,
                "state_dir": str(out / "state"),
                "weigh_deadline_s": 600.0,
            },
            "regressor": {"processes": 0},
            "aggregator": {"out": str(out), "exit_when_final": True, "camera_stall_s": 600.0},
        }
        for section, values in (settings or {}).items():
            raw[section] = {**raw.get(section, {}), **values}
        self.config.write_text(dump_toml(parse_config(raw, where="of the benchmark")))

    def __enter__(self) -> Self:
        self.start("edge", "router", "--config", self.config, name="router")
        return self

    def __exit__(self, *_: object) -> None:
        self._end_all()
        self._stack.close()

    def start(self, host: str, *args: str | Path, name: str) -> None:
        """One `tuberline` process on `host`."""
        self._spawn(host, [sys.executable, "-m", "tuberline", *map(str, args)], name=name, stdout=subprocess.DEVNULL)

    def start_node(self, host: str, role: str, *args: str) -> None:
        """A node of this line on `host`."""
        name = f"{role}/{args[-1]}" if args else role
        self.start(host, role, "--config", self.config, "--run", RUN, *args, name=name)

    def start_probe(self, *probe: str) -> None:
        """The watcher beside the router: a module that writes JSON lines, and its arguments."""
        command = [sys.executable, "-m", *(probe or ("benchmarks.site_probe", self.router, LINE))]
        self._spawn("edge", command, name="probe", stdout=subprocess.PIPE)
        self._reader = threading.Thread(target=self._read_probe, name="probe", daemon=True)
        self._reader.start()

    def limit(self, name: str, *, share: float) -> None:
        """Give a process this share of one core from now on."""
        group = CpuShare(f"{self.network.namespace('share')}-{name.replace('/', '-')}", share=share)
        self._stack.enter_context(group)
        group.add(self._processes[name].pid)

    def wait_alive(self, names: Sequence[str], *, timeout_s: float = 300.0) -> None:
        """Until all these nodes show their tokens."""
        self.wait(
            lambda: set(names) <= set(self._latest.get("alive", ())), what=f"{list(names)} alive", timeout_s=timeout_s
        )

    def is_alive(self, prefix: str) -> bool:
        """A node whose 'role/name' begins so shows its token."""
        return any(name.startswith(prefix) for name in self._latest.get("alive", ()))

    @property
    def weights(self) -> int:
        """Weights that have passed the router."""
        return self.seen("weights")

    def seen(self, what: str) -> int:
        """How many of those the probe has seen; 0 where it has not said."""
        return int(self._latest.get(what, 0))

    def wait(self, true: Any, *, what: str, timeout_s: float) -> None:
        """Poll until `true()`; raises after the deadline, or when a process failed."""
        deadline = time.monotonic() + timeout_s
        while not true():
            if time.monotonic() > deadline:
                raise TuberlineError(
                    f"waited {timeout_s:g} s for {what}, which did not come; logs are in {self.out / 'logs'}"
                )
            for name, process in self._processes.items():
                if (process.poll() or 0) > 0:
                    raise TuberlineError(f"{name} ended with {process.returncode}; logs are in {self.out / 'logs'}")
            time.sleep(0.05)

    @property
    def finished(self) -> bool:
        """The aggregator has written its summary."""
        return self._processes["aggregator"].poll() == 0

    def wait_finished(self, *, timeout_s: float = 110.0) -> None:
        """Until the aggregator has written its summary."""
        self.wait(lambda: self.finished, what="the summary", timeout_s=timeout_s)

    def signal(self, name: str, number: signal.Signals) -> None:
        """Send a process a signal."""
        self._processes[name].send_signal(number)

    def finish_probe(self) -> dict[str, Any]:
        """Everything the probe has seen."""
        self._processes["probe"].send_signal(signal.SIGTERM)
        self._reader.join(20.0)
        if not self._latest.get("last"):
            raise TuberlineError(f"the probe said nothing at its end; logs are in {self.out / 'logs'}")
        return self._latest

    def traffic(self, hosts: Sequence[str]) -> dict[str, Traffic]:
        """Bytes through each host's link so far."""
        return {host: self.network.traffic(host) for host in hosts}

    def cpu_s(self) -> dict[str, float]:
        """CPU seconds each running process has used."""
        return {name: cpu_s(process.pid) for name, process in self._processes.items() if process.poll() is None}

    def _spawn(self, host: str, command: list[str], *, name: str, stdout: int) -> None:
        logs = self.out / "logs"
        logs.mkdir(exist_ok=True)
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
        with (logs / f"{name.replace('/', '-')}.log").open("ab") as log:
            self._processes[name] = subprocess.Popen(
                self.network.command(host, command),
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=log,
                env=environment,
            )

    def _read_probe(self) -> None:
        stream = self._processes["probe"].stdout
        for line in stream or ():
            self._latest = json.loads(line)

    def _end_all(self) -> None:
        """SIGTERM to all but the router, then the router; SIGKILL to who stays."""
        for names in ([n for n in self._processes if n != "router"], ["router"]):
            for name in names:
                with suppress(ProcessLookupError, KeyError):
                    self._processes[name].terminate()
                    self._processes[name].send_signal(signal.SIGCONT)
            deadline = time.monotonic() + 5.0
            for process in (self._processes[n] for n in names if n in self._processes):
                try:
                    process.wait(max(0.1, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
