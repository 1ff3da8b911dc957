"""A live line at stated rates: CPU and memory per process, frames and views lost by reason, latency by hop.

    python -m benchmarks line --seconds 60 --cameras 2 --fps 15 --tubers-per-s 20 [--out FOLDER]

A simulated recording, its belt as full as the asked rate needs (or, in bursts, as fast), is laid end to end and played
by cameras that wait for no one, by one clock, as all cameras of a line see one belt; router, segmenters, regressors and
aggregator are the real processes, all on this machine. What else runs on the machine decides the figures: the load
average stands beside them.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.line_belt import SCENES, simulated_belt
from benchmarks.line_table import markdown
from benchmarks.line_watch import TOTAL, Watcher, latencies_s, percentile
from benchmarks.options import above_zero, parser_of, whole_number
from benchmarks.proc import cpu_s
from benchmarks.soak import loop, sample
from conveyor.config import LineConfig, dump_toml
from conveyor.errors import TuberlineError
from conveyor.messages import Counters
from tuberline.processes import line_processes
from tuberline.replayer import prepare_out, recording_cameras, replay_config
from tuberline.supervisor import Supervisor

RUN = "bench"
START_LIMIT_S = 120.0
STARTS_IN_S = 10.0
"""The belt begins to run when the processes are there: what passes before is not looked at."""
LEVELS = ("views_per_tuber", "views_outstanding", "regressors_busy_share", "frame_age_max_ms", "frame_ms")
"""Gauges that are no sums."""


@dataclass(slots=True)
class Usage:
    """What one process took in the measured time."""

    cpu_percent: float
    memory_mib: float
    restarts: int


@dataclass(slots=True)
class Measured:
    """What was seen of the line in `seconds`."""

    seconds: float
    usage: dict[str, Usage] = field(default_factory=dict)
    load_average: tuple[float, float] = (0.0, 0.0)
    """At the start and the end; the line's own processes are in it."""
    sheets: dict[str, Counters] = field(default_factory=dict)
    sheets_before: dict[str, Counters] = field(default_factory=dict)
    router_bytes: int | None = None
    """That the router received; None where no `ss` tells."""
    latencies: dict[str, list[float]] = field(default_factory=dict)
    tubers: int = 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the line and tell what was measured."""
    options = _options(arguments)
    with tempfile.TemporaryDirectory() as folder:
        recording = options.recording or Path(folder) / "belt"
        if options.recording is None:
            simulated_belt(
                recording, cameras=options.cameras, tubers_per_s=options.tubers_per_s, tubers=options.tubers,
                fps=options.fps, seed=options.seed, load=options.load,
            )  # fmt: skip
        looped = loop(recording, Path(folder) / "looped", for_s=options.seconds + options.warm_up_s + START_LIMIT_S)
        out = options.out or Path(folder) / "out"
        config = live_config(looped, out, options)
        measured = measure(config, out, warm_up_s=options.warm_up_s, seconds=options.seconds)
        report = told(measured, options)
        (out / "line.json").write_text(json.dumps(report, indent=1) + "\n")
        print(markdown(report))
    return 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = parser_of("line", __doc__)
    parser.add_argument("--seconds", type=above_zero, default=60.0, help="measured for so long, after the warm-up")
    parser.add_argument("--warm-up-s", type=float, default=12.0)
    parser.add_argument("--cameras", type=int, choices=sorted(SCENES), default=2)
    parser.add_argument("--fps", type=above_zero, default=15.0)
    parser.add_argument("--tubers-per-s", type=above_zero, default=20.0, help="in the mean")
    parser.add_argument("--tubers", type=whole_number(1), default=400, help="of the recording that is repeated")
    parser.add_argument(
        "--load", choices=("even", "bursts"), default="even", help="bursts: a full belt, then a bare one"
    )
    parser.add_argument("--seed", type=whole_number(0), default=11)
    parser.add_argument("--regressors", type=whole_number(1), default=2)
    parser.add_argument("--precision", choices=("auto", "float32", "bfloat16"), default="auto")
    parser.add_argument("--centroids", type=int, choices=(16, 32, 64))
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="what the regressors weigh on")
    parser.add_argument("--direct", choices=("auto", "off"), default="auto", help="off: frames pass the router")
    parser.add_argument("--recording", type=Path, help="folder recording to repeat; default: a simulated one")
    parser.add_argument("--out", type=Path, help="keep ledger, logs and line.json here")
    return parser.parse_args(arguments)


def live_config(recording: Path, out: Path, options: argparse.Namespace) -> LineConfig:
    """The line as `tuberline run` would have it, its cameras played from `recording`."""
    prepare_out(out)
    names = recording_cameras(recording)
    starts_at_s = time.time() + STARTS_IN_S
    regressor: dict[str, Any] = {
        "processes": options.regressors,
        "precision": options.precision,
        "device": options.device,
    }
    if options.centroids:
        regressor["centroids"] = options.centroids
    live: Mapping[str, Any] = {
        "cameras": {
            name: {
                "path": str(recording.resolve()),
                "speed": 1.0,
                "waits": False,
                "starts_at_s": starts_at_s,
                "direct": options.direct,
            }
            for name in names
        },
        "segmenter": {"weigh_deadline_s": 60.0},
        "regressor": regressor,
        "aggregator": {"exit_when_final": False, "camera_stall_s": 10.0},
    }
    return replay_config(
        recording, names, out=out, speed=1.0, weights=None, regressors=options.regressors, rrd=None, settings=live
    )


def measure(config: LineConfig, out: Path, *, warm_up_s: float, seconds: float) -> Measured:
    """Start the line, wait until tubers are committed and the warm-up is over, then watch for `seconds`."""
    config_path = out / "line.toml"
    config_path.write_text(dump_toml(config))
    specs = line_processes(config, config_path=config_path, run=RUN)
    measured = Measured(seconds)
    with Supervisor(specs, log_dir=out / "logs") as supervisor, Watcher(config.link, line=config.name) as watcher:
        deadline = time.monotonic() + START_LIMIT_S
        while not watcher.stamps.committed:
            if time.monotonic() > deadline:
                raise TuberlineError(f"no tuber was committed within {START_LIMIT_S:g} s; logs are in {out / 'logs'}")
            time.sleep(0.1)
        time.sleep(warm_up_s)
        from_ns, load_before = time.time_ns(), os.getloadavg()[0]
        measured.sheets_before = watcher.observer.nodes()
        before = {spec.name: cpu_s(supervisor.pid(spec.name)) for spec in specs}
        begun, bytes_before = time.monotonic(), received_bytes(supervisor.pid("router"))
        time.sleep(seconds)
        measured.seconds = time.monotonic() - begun
        bytes_after = received_bytes(supervisor.pid("router"))
        if bytes_before is not None and bytes_after is not None:
            measured.router_bytes = bytes_after - bytes_before
        for spec in specs:
            pid = supervisor.pid(spec.name)
            used_s = cpu_s(pid) - before[spec.name]
            seen = sample(pid, 0.0) if pid is not None else None
            measured.usage[spec.name] = Usage(
                100 * used_s / measured.seconds, seen.share_mib if seen else 0.0, supervisor.restarts[spec.name]
            )
        measured.load_average = (load_before, os.getloadavg()[0])
        measured.sheets = watcher.observer.nodes()
        measured.latencies = latencies_s(watcher.stamps, from_ns=from_ns)
        measured.tubers = sum(1 for committed_ns, _ in watcher.stamps.committed if committed_ns >= from_ns)
    return measured


def received_bytes(pid: int | None) -> int | None:
    """Bytes that the TCP sockets of a process, still open, have received; None where no `ss` tells."""
    try:
        listed = subprocess.run(["ss", "-tinpHO"], capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return None
    own = [line for line in listed.splitlines() if f"pid={pid}," in line]
    return sum(int(found[1]) for line in own if (found := re.search(r"bytes_received:(\d+)", line)))


def told(measured: Measured, options: argparse.Namespace) -> dict[str, Any]:
    """Everything that was measured, as plain values; `start`: what had become of the frames before."""
    hops = {
        hop: {"p50_s": percentile(values, 0.5), "p99_s": percentile(values, 0.99), "n": len(values)}
        for hop, values in measured.latencies.items()
        if values
    }
    return {
        "machine": {"cores": os.cpu_count(), "machine": platform.machine(), "python": platform.python_version()},
        "asked": {
            name: getattr(options, name)
            for name in (
                "cameras",
                "fps",
                "tubers_per_s",
                "regressors",
                "precision",
                "centroids",
                "device",
                "direct",
                "load",
                "tubers",
                "seed",
                "seconds",
            )
        },
        "load_average": measured.load_average,
        "tubers_per_s": measured.tubers / measured.seconds,
        "router_mb_per_s": None if measured.router_bytes is None else measured.router_bytes / 1e6 / measured.seconds,
        "cpu_percent": sum(usage.cpu_percent for usage in measured.usage.values()),
        "processes": {
            name: {"cpu_percent": usage.cpu_percent, "memory_mib": usage.memory_mib, "restarts": usage.restarts}
            for name, usage in measured.usage.items()
        },
        "segmenters": {
            name: sheet(c, measured.sheets_before.get(name))
            for name, c in measured.sheets.items()
            if c.role == "segmenter"
        },
        "start": {
            name: {what: n for what, n in c.gauges.items() if what.startswith("frames_")}
            for name, c in measured.sheets_before.items()
            if c.role == "segmenter"
        },
        "latency": hops,
        "crossing_to_ledger": hops.get(TOTAL, {}),
    }


def sheet(counters: Counters, before: Counters | None) -> dict[str, float]:
    """A segmenter's books of the measured time, and how many views it weighs per tuber.

    What happened while the processes started, before the measured time, is in neither.
    """
    wanted = ("frames_", "views_", "tracks_counted", *LEVELS)
    books = {name: level for name, level in counters.gauges.items() if name.startswith(wanted)}
    for name, level in (before.gauges if before else {}).items():
        if name in books and not name.startswith(LEVELS):
            books[name] -= level
    tracks = books.get("tracks_counted", 0.0)
    return {**books, "views_weighed_per_track": books.get("views_weighed", 0.0) / tracks if tracks else 0.0}
