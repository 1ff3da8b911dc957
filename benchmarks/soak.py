"""A live line for minutes or hours, somebody killed every minute: does anything grow?

    python -m benchmarks.soak --minutes 30 [--recording FOLDER] [--out FOLDER]

A recording is laid end to end (links to its frames, travel going on) and played in real time to a line whose cameras
wait for nobody. In turn segmenter, regressor, aggregator and router are killed with SIGKILL. Memory, descriptors and
threads of each process and the files in /dev/shm are sampled; the table is Markdown.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from conveyor.cli.replay import prepare_out, recording_cameras, replay_config
from conveyor.config import dump_toml
from conveyor.processes import line_processes
from conveyor.supervisor import Supervisor

SAMPLE_S = 5.0
SETTLED_S = 40.0
"""A process is measured from this age on: before that it loads and compiles."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One process at one moment."""

    at_s: float
    age_s: float
    rss_mib: float
    descriptors: int
    threads: int


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the line and print what was measured; 1 where the books do not balance."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--kill-every-s", type=float, default=60.0)
    parser.add_argument("--recording", type=Path, help="folder recording to repeat; default: a simulated one")
    parser.add_argument("--out", type=Path, help="keep ledger and logs here")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        recording = options.recording or simulated(Path(folder) / "belt")
        looped = loop(recording, Path(folder) / "looped", for_s=options.minutes * 60 + 60)
        out = options.out or Path(folder) / "out"
        return soak(looped, out, for_s=options.minutes * 60, kill_every_s=options.kill_every_s)


def simulated(path: Path) -> Path:
    """A few seconds of belt."""
    tuberline("simulate", "--out", str(path), "--seed", "11", "--scene", "touching", "--tubers", "60", "--fps", "15")
    return path


def loop(recording: Path, into: Path, *, for_s: float) -> Path:
    """A folder recording that repeats `recording`, of every camera, for at least `for_s` seconds."""
    for camera in recording_cameras(recording):
        source, target = recording / camera, into / camera
        (target / "depth").mkdir(parents=True)
        shutil.copy(source / "camera.json", target)
        with (source / "frames.csv").open(newline="") as file:
            rows = [(int(r["seq"]), int(r["captured_ns"]), float(r["travel_m"])) for r in csv.DictReader(file)]
        step_ns, step_m = (rows[-1][1] - rows[0][1]) // (len(rows) - 1), (rows[-1][2] - rows[0][2]) / (len(rows) - 1)
        lap_ns, lap_m = rows[-1][1] - rows[0][1] + step_ns, rows[-1][2] - rows[0][2] + step_m
        seq = 0
        with (target / "frames.csv").open("w") as file:
            file.write("seq,captured_ns,travel_m\n")
            for lap in range(int(for_s * 1e9 / lap_ns) + 1):
                for old, captured_ns, travel_m in rows:
                    file.write(f"{seq},{captured_ns + lap * lap_ns},{travel_m + lap * lap_m!r}\n")
                    (target / "depth" / f"{seq:06d}.png").symlink_to(source.resolve() / "depth" / f"{old:06d}.png")
                    seq += 1
    if (recording / "line.json").is_file():
        shutil.copy(recording / "line.json", into)
    return into


def soak(recording: Path, out: Path, *, for_s: float, kill_every_s: float) -> int:
    """Run a live line on `recording`; prints the table and the audit."""
    prepare_out(out)
    names = recording_cameras(recording)
    cameras = {name: {"path": str(recording.resolve()), "speed": 1.0, "waits": False} for name in names}
    config = replay_config(
        recording, names, out=out, speed=1.0, weights=None, regressors=2, rrd=None, settings={"cameras": cameras}
    )
    config_path = out / "line.toml"
    config_path.write_text(dump_toml(config))
    victims = [f"segmenter-{names[0]}", "regressor-r1", "aggregator", "router"]
    samples: dict[str, list[Sample]] = defaultdict(list)
    shm: list[int] = []
    specs = line_processes(config, config_path=config_path, run="soak")
    with Supervisor(specs, log_dir=out / "logs") as supervisor:
        started = time.monotonic()
        kill_due, sample_due, kills = started + kill_every_s, started, 0
        while (now := time.monotonic()) < started + for_s:
            supervisor.poll()
            if now >= kill_due:
                pid = supervisor.pid(victims[kills % len(victims)])
                if pid is not None:
                    os.kill(pid, signal.SIGKILL)
                    kills += 1
                kill_due += kill_every_s
            if now >= sample_due:
                sample_due += SAMPLE_S
                shm.append(len(list(Path("/dev/shm").iterdir())))
                for spec in specs:
                    if (pid := supervisor.pid(spec.name)) is not None and (seen := sample(pid, now - started)):
                        samples[spec.name].append(seen)
            time.sleep(0.2)
        restarts = supervisor.restarts
    print_table(samples, restarts, shm, minutes=for_s / 60, kills=kills)
    return print_books(out)


def sample(pid: int, at_s: float) -> Sample | None:
    """Look at a process; None where it has just gone."""
    try:
        status = dict(
            line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines() if ":" in line
        )
        ticks = int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[19])
        descriptors = len(os.listdir(f"/proc/{pid}/fd"))
        uptime_s = float(Path("/proc/uptime").read_text().split()[0])
        age_s = uptime_s - ticks / os.sysconf("SC_CLK_TCK")
        return Sample(at_s, age_s, int(status["VmRSS"].split()[0]) / 1024, descriptors, int(status["Threads"]))
    except (OSError, KeyError, IndexError):
        return None


def print_table(
    samples: dict[str, list[Sample]], restarts: dict[str, int], shm: list[int], *, minutes: float, kills: int
) -> None:
    """Figures of each process from the age at which it has settled; growth between the first and last third."""
    print(f"{minutes:g} minutes, {kills} kills; {shm[0]} files in /dev/shm at the start, {shm[-1]} at the end\n")
    print("| process | restarts | RSS MiB first, last, most | growth MiB/h | descriptors first, last, most | threads |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name, all_seen in samples.items():
        seen = [s for s in all_seen if s.age_s >= SETTLED_S]
        if len(seen) < 3:
            print(f"| {name} | {restarts[name]} | too short | | | |")
            continue
        rss, fds = [s.rss_mib for s in seen], [s.descriptors for s in seen]
        threads = sorted({s.threads for s in seen})
        print(
            f"| {name} | {restarts[name]} | {rss[0]:.0f}, {rss[-1]:.0f}, {max(rss):.0f} | {growth_mib_h(seen):+.0f} "
            f"| {fds[0]}, {fds[-1]}, {max(fds)} | {threads[0]} to {threads[-1]} |"
        )


def growth_mib_h(seen: list[Sample]) -> float:
    """Growth within the lives of a process, MiB per hour: a restart begins anew and counts for nothing."""
    gained = lived_s = 0.0
    for before, after in pairwise(seen):
        if after.age_s > before.age_s:
            gained += after.rss_mib - before.rss_mib
            lived_s += after.at_s - before.at_s
    return gained / lived_s * 3600 if lived_s else 0.0


def print_books(out: Path) -> int:
    """The audit of what was counted."""
    audit = tuberline("audit", str(out), "--json", check=False)
    books = json.loads(audit.stdout)
    print(f"\naudit: {'balanced' if books['balanced'] else 'NOT BALANCED'}; tracks {books['tracks']}")
    for camera, sheet in books["cameras"].items():
        print(f"{camera}: frames {sheet['frames']}; views {sheet['views']}; tracks {sheet['tracks']}")
    ledger = sum(file.stat().st_size for file in out.glob("ledger.db*"))
    logs = sum(file.stat().st_size for file in (out / "state").glob("*"))
    print(f"ledger {ledger / 1024:.0f} KiB, track logs {logs / 1024:.0f} KiB")
    return audit.returncode


def tuberline(*arguments: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    """The command as a user runs it."""
    command = [sys.executable, "-m", "conveyor", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=check)


if __name__ == "__main__":
    sys.exit(main())
