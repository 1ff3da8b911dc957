"""A line on three hosts whose network loses, delays, throttles or is cut: is the ledger the undisturbed one?

    python -m benchmarks partitions [RECORDING] [--only cut-3s ...]          # as root

Three network namespaces stand for three hosts: camera and segmenter, regressors, aggregator and router. The first two
are joined to the third by an emulated link each (`benchmarks.link`). Addresses exist inside only. The recording is
replayed, so that nothing may be lost at all: the canonical ledger must be the same, byte for byte.
"""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from benchmarks.command import tuberline
from benchmarks.link import EmulatedLink, why_no_links
from benchmarks.link_wire import Counts, LinkSettings
from benchmarks.options import parser_of
from benchmarks.site_net import TCP, Network
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings
from conveyor.config import dump_toml
from conveyor.errors import TuberlineError
from tuberline.processes import line_processes
from tuberline.replayer import fingerprint, prepare_out, recording_cameras, replay_config

ROLES = {"camera": "field", "segmenter": "field", "regressor": "weigh", "aggregator": "yard", "router": "yard"}
FAR_HOSTS = ("field", "weigh")
CUT_AFTER_ENTRIES = 4
"""A camera's log with so many entries has tubers in it: the line is at work."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """What both links suffer all along, and for how long they are cut in the middle of the work."""

    name: str
    link: LinkSettings = field(default_factory=LinkSettings)
    cut_s: float = 0.0
    timeout_s: float = 400.0
    tcp: str = TCP


SLOW = LinkSettings(delay_s=0.050, jitter_s=0.010, loss=0.05, bits_per_s=10e6)
TROUBLES = (
    Trouble("undisturbed"),
    Trouble("loss-5%", LinkSettings(loss=0.05)),
    Trouble("delay-50ms", LinkSettings(delay_s=0.050, jitter_s=0.010)),
    Trouble("rate-10mbit", LinkSettings(bits_per_s=10e6)),
    Trouble("cut-3s", cut_s=3.0),
    Trouble("cut-15s", cut_s=15.0),
    # Any other congestion control than BBR takes 5 % loss at 100 ms for a crowd: 0.5 Mbit/s is all it sends then.
    Trouble("all-together", SLOW, cut_s=15.0, timeout_s=900.0, tcp="bbr"),
)


@dataclass(frozen=True, slots=True)
class Replayed:
    """How a replay over troubled links went; counts by far host, from it and to it."""

    took_s: float
    links: dict[str, tuple[Counts, Counts]]

    def total(self, name: str) -> int:
        """Sum of a count over both links and directions."""
        return sum(getattr(counts, name) for both in self.links.values() for counts in both)


def why_not(trouble: Trouble) -> str:
    """Why this machine cannot make `trouble`; empty where it can."""
    if reason := why_no_links():
        return reason
    allowed = Path("/proc/sys/net/ipv4/tcp_allowed_congestion_control").read_text().split()
    return "" if trouble.tcp in allowed else f"congestion control {trouble.tcp} is not allowed here ({allowed} are)"


@contextmanager
def line_on(network: Network, recording: Path, out: Path) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """The line at work on the three hosts; gives its processes by name."""
    prepare_out(out)
    cameras = {
        name: {"path": str(recording.resolve()), "speed": 0.0, "compress": "zstd"}
        for name in recording_cameras(recording)
    }
    config = replay_config(
        recording, list(cameras), out=out, speed=0.0, weights=None, regressors=2, rrd=None,
        settings={
            "link": {"router": f"tcp/{network.address('yard')}:7447", "connect_timeout_s": 120.0},
            "cameras": cameras,
        },
    )  # fmt: skip
    config_path = out / "line.toml"
    config_path.write_text(dump_toml(config))
    (out / "logs").mkdir()
    processes: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for spec in line_processes(config, config_path=config_path, run=f"replay-{fingerprint(recording)}"):
            command = network.command(ROLES[spec.args[0]], [sys.executable, "-m", "tuberline", *spec.args])
            with (out / "logs" / f"{spec.name}.log").open("wb") as log:
                processes[spec.name] = subprocess.Popen(
                    command, stdin=subprocess.DEVNULL, stderr=log, env={**os.environ, "OMP_NUM_THREADS": "1"}
                )
        yield processes
    finally:
        for process in processes.values():
            process.terminate()
        for process in processes.values():
            try:
                process.wait(8)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def troubled_replay(recording: Path, out: Path, trouble: Trouble) -> Replayed:
    """Replay `recording` into `out` on three hosts.

    Raises:
        TuberlineError: no namespaces or TAP devices here, or a node ended.
        TimeoutError: the summary was not there in time; the nodes' logs are in `out`.
    """
    with Network(tcp=trouble.tcp) as network:
        network.add("yard")
        links = {host: network.add_far(host, trouble.link, seed=n) for n, host in enumerate(FAR_HOSTS, 1)}
        started = time.monotonic()
        with line_on(network, recording, out) as nodes:
            deadline = started + trouble.timeout_s
            cut_due = trouble.cut_s > 0
            while nodes["aggregator"].poll() is None:
                if time.monotonic() > deadline:
                    raise TimeoutError(f"{trouble.name}: no summary after {trouble.timeout_s:g} s; see {out / 'logs'}")
                _raise_failed(nodes, out)
                if cut_due and any(_entries(log) > CUT_AFTER_ENTRIES for log in (out / "state").glob("*.db")):
                    _cut(links, trouble)
                    cut_due = False
                time.sleep(0.05)
            _raise_failed(nodes, out)
            if cut_due:
                raise TimeoutError(f"{trouble.name}: the line was done before the cut")
            took_s = time.monotonic() - started
            return Replayed(took_s, {host: link.counts() for host, link in links.items()})


def _raise_failed(nodes: dict[str, subprocess.Popen[bytes]], out: Path) -> None:
    for name, process in nodes.items():
        if process.poll() or (process.returncode == 0 and name != "aggregator"):
            raise TuberlineError(f"{name} ended with code {process.returncode}; see {out / 'logs' / f'{name}.log'}")


def _entries(log: Path) -> int:
    """How many entries a segmenter has logged; 0 while its file is being made."""
    with suppress(sqlite3.Error), closing(sqlite3.connect(f"file:{log}?mode=ro", uri=True)) as db:
        return int(db.execute("SELECT coalesce(max(newest), 0) FROM state").fetchone()[0])
    return 0


def _cut(links: dict[str, EmulatedLink], trouble: Trouble) -> None:
    """Nothing passes either link for a while, and no one is told."""
    for settings in (replace(trouble.link, cut=True), trouble.link):
        for link in links.values():
            link.set(settings)
        if settings.cut:
            time.sleep(trouble.cut_s)


def canonical(out: Path) -> str:
    """The canonical export of a run's ledger."""
    return tuberline("ledger", "export", out / "ledger.db", "--canonical")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the troubles and print a Markdown table; 1 where a ledger differs."""
    parser = parser_of("partitions", __doc__)
    parser.add_argument("recording", type=Path, nargs="?", help="default: a simulated one, two cameras, 24 tubers")
    names = [trouble.name for trouble in TROUBLES]
    parser.add_argument("--only", nargs="+", choices=names, default=names, help="beside the undisturbed one")
    parser.add_argument("--out", type=Path, help="keep ledgers and logs here")
    options = parser.parse_args(arguments)
    print("| network | tubers | gaps | MB over both links | packets lost: loss, queue, cut | time s | ledger |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    calm, failures = "", 0
    with tempfile.TemporaryDirectory() as folder:
        recording = options.recording or _simulated(Path(folder) / "belt")
        for trouble in TROUBLES:
            if trouble.name not in options.only and trouble is not TROUBLES[0]:
                continue
            if reason := why_not(trouble):
                print(f"| {trouble.name} | | | | | | skipped: {reason} |")
                continue
            out = (options.out or Path(folder)) / trouble.name
            replayed = troubled_replay(recording, out, trouble)
            ledger = canonical(out)
            calm = calm or ledger
            failures += ledger != calm
            print(_row(trouble, replayed, out, equal=ledger == calm), flush=True)
    return 1 if failures else 0


def _simulated(out: Path) -> Path:
    record_scene(out, SceneSettings("two-cameras", seed=11, tubers=24, preset=PRESETS["easy"], fps=15.0))
    return out


def _row(trouble: Trouble, replayed: Replayed, out: Path, *, equal: bool) -> str:
    summary = json.loads((out / "summary.json").read_text())
    sheets = [sheet["frames"] for sheet in summary["cameras"].values()]
    lost = ", ".join(str(replayed.total(f"lost_{reason}")) for reason in ("loss", "queue", "cut"))
    cells = (
        trouble.name,
        str(summary["totals"]["count"]),
        str(sum(sheet["gaps"] for sheet in sheets)),
        f"{replayed.total('forwarded_bytes') / 1e6:.0f}",
        lost,
        f"{replayed.took_s:.1f}",
        "equal" if equal else "DIFFERS",
    )
    return f"| {' | '.join(cells)} |"
