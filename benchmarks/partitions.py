"""A line on three hosts whose network misbehaves: does the ledger come out as if nothing had happened?

    python -m benchmarks.partitions RECORDING [--only cut-3s ...]

Three network namespaces stand for three hosts: camera and segmenter, regressors, aggregator and router. They are joined
by a bridge that lives in the third; all names carry this process' id and all addresses exist inside only. Needs root.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from conveyor.cli.replay import fingerprint, prepare_out, recording_cameras, replay_config
from conveyor.config import dump_toml
from conveyor.processes import line_processes

HOSTS = ("field", "weigh", "yard")
ROLES = {"camera": "field", "segmenter": "field", "regressor": "weigh", "aggregator": "yard", "router": "yard"}
ADDRESS = {"yard": "10.77.0.1", "field": "10.77.0.2", "weigh": "10.77.0.3"}
CUT_AFTER_BYTES = 3000
"""A camera's log of this size has tubers in it: the line is at work."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """What the links of camera and regressors suffer: a queueing discipline all along, or a cut in the middle."""

    name: str
    qdisc: str = ""
    cut_s: float = 0.0


TROUBLES = (
    Trouble("undisturbed"),
    Trouble("loss-5%", qdisc="netem loss 5%"),
    Trouble("delay-50ms", qdisc="netem delay 50ms"),
    Trouble("rate-10mbit", qdisc="tbf rate 10mbit burst 64kb latency 200ms"),
    Trouble("cut-3s", cut_s=3.0),
    Trouble("cut-15s", cut_s=15.0),
)


def why_not(trouble: Trouble) -> str:
    """Why this machine cannot make `trouble`; empty where it can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    missing = [tool for tool in ("ip", "tc") if shutil.which(tool) is None]
    if missing:
        return f"{' and '.join(missing)} of iproute2 missing"
    try:
        with Network() as network:
            if trouble.qdisc:
                network.spoil(trouble.qdisc)
    except RuntimeError as error:
        return str(error)
    return ""


class Network:
    """Three hosts on one bridge. Use as a context manager."""

    def __init__(self) -> None:
        self._name = {host: f"tl{os.getpid()}{host}" for host in HOSTS}

    def __enter__(self) -> Network:
        try:
            self._make()
        except RuntimeError:
            self.__exit__()
            raise
        return self

    def _make(self) -> None:
        yard = self._name["yard"]
        for host in HOSTS:
            _run("ip", "netns", "add", self._name[host])
            self._ip(host, "link", "set", "lo", "up")
        self._ip("yard", "link", "add", "br0", "type", "bridge")
        self._ip("yard", "addr", "add", f"{ADDRESS['yard']}/24", "dev", "br0")
        self._ip("yard", "link", "set", "br0", "up")
        for host in ("field", "weigh"):
            self._ip(host, "link", "add", "eth0", "type", "veth", "peer", "name", f"to-{host}", "netns", yard)
            self._ip(host, "addr", "add", f"{ADDRESS[host]}/24", "dev", "eth0")
            self._ip(host, "link", "set", "eth0", "up")
            self._ip("yard", "link", "set", f"to-{host}", "master", "br0")
            self._ip("yard", "link", "set", f"to-{host}", "up")

    def __exit__(self, *_: object) -> None:
        for name in self._name.values():
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)

    def command(self, host: str, *command: str) -> list[str]:
        """`command` as run on that host."""
        return ["ip", "netns", "exec", self._name[host], *command]

    def spoil(self, qdisc: str) -> None:
        """Spoil both links, both ways."""
        for host in ("field", "weigh"):
            for where, device in ((host, "eth0"), ("yard", f"to-{host}")):
                _run(*self.command(where, "tc", "qdisc", "add", "dev", device, "root", *qdisc.split()))

    def cut(self, seconds: float) -> None:
        """Take both links down for a while."""
        for state in ("down", "up"):
            for host in ("field", "weigh"):
                self._ip("yard", "link", "set", f"to-{host}", state)
            if state == "down":
                time.sleep(seconds)

    def _ip(self, host: str, *arguments: str) -> None:
        _run("ip", "-n", self._name[host], *arguments)


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()}")


@contextmanager
def line_on(network: Network, recording: Path, out: Path) -> Iterator[subprocess.Popen[bytes]]:
    """The line at work on the three hosts; gives the aggregator's process."""
    prepare_out(out)
    cameras = {
        name: {"path": str(recording.resolve()), "speed": 0.0, "compress": "zstd"}
        for name in recording_cameras(recording)
    }
    config = replay_config(
        recording, list(cameras), out=out, speed=0.0, weights=None, regressors=2, rrd=None,
        settings={"link": {"router": f"tcp/{ADDRESS['yard']}:7447"}, "cameras": cameras},
    )  # fmt: skip
    config_path = out / "line.toml"
    config_path.write_text(dump_toml(config))
    (out / "logs").mkdir()
    processes: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for spec in line_processes(config, config_path=config_path, run=f"replay-{fingerprint(recording)}"):
            command = network.command(ROLES[spec.args[0]], sys.executable, "-m", "conveyor", *spec.args)
            with (out / "logs" / f"{spec.name}.log").open("wb") as log:
                processes[spec.name] = subprocess.Popen(
                    command, stdin=subprocess.DEVNULL, stderr=log, env={**os.environ, "OMP_NUM_THREADS": "1"}
                )
        yield processes["aggregator"]
    finally:
        for process in processes.values():
            process.terminate()
        for process in processes.values():
            try:
                process.wait(8)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def troubled_replay(recording: Path, out: Path, trouble: Trouble, *, timeout_s: float = 240.0) -> float:
    """Replay `recording` into `out` on three hosts; returns the seconds it took.

    Raises:
        TimeoutError: the summary was not there in time; the nodes' logs are in `out`.
    """
    with Network() as network:
        if trouble.qdisc:
            network.spoil(trouble.qdisc)
        started = time.monotonic()
        with line_on(network, recording, out) as aggregator:
            deadline = started + timeout_s
            cut_due = trouble.cut_s > 0
            while aggregator.poll() is None:
                if time.monotonic() > deadline:
                    raise TimeoutError(f"{trouble.name}: no summary after {timeout_s:g} s; see {out / 'logs'}")
                if cut_due and any(log.stat().st_size > CUT_AFTER_BYTES for log in (out / "state").glob("*.log")):
                    network.cut(trouble.cut_s)
                    cut_due = False
                time.sleep(0.05)
            if cut_due:
                raise TimeoutError(f"{trouble.name}: the line was done before the cut")
            return time.monotonic() - started


def canonical(out: Path) -> str:
    """The canonical export of a run's ledger."""
    command = [sys.executable, "-m", "conveyor", "ledger", "export", str(out / "ledger.db"), "--canonical"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the troubles and print a Markdown table; 1 where a ledger differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--only", nargs="*", default=[trouble.name for trouble in TROUBLES])
    options = parser.parse_args(arguments)
    print("| network | tubers | gaps | time s | ledger |\n| --- | --- | --- | --- | --- |")
    calm, failures = "", 0
    with tempfile.TemporaryDirectory() as folder:
        for trouble in TROUBLES:
            if trouble.name not in options.only and trouble is not TROUBLES[0]:
                continue
            if reason := why_not(trouble):
                print(f"| {trouble.name} | | | | skipped: {reason} |")
                continue
            out = Path(folder) / trouble.name
            took_s = troubled_replay(options.recording, out, trouble)
            ledger = canonical(out)
            calm = calm or ledger
            failures += ledger != calm
            summary = json.loads((out / "summary.json").read_text())
            gaps = sum(sheet["frames"]["gaps"] for sheet in summary["cameras"].values())
            count = summary["totals"]["count"]
            print(f"| {trouble.name} | {count} | {gaps} | {took_s:.1f} | {'equal' if ledger == calm else 'DIFFERS'} |")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
