"""A live line for minutes or hours, somebody killed every minute: does anything grow?

    python -m benchmarks soak --minutes 30 --out FOLDER [--recording FOLDER] [--kill-every-s 60]

A recording is laid end to end (links to its frames, travel going on) and played in real time to a line whose cameras
wait for no one. Camera, segmenter, regressor, aggregator and router are killed in turn with SIGKILL; a second regressor
never is. Memory, descriptors and threads of each process and of the one that they are forked from, and the files in
/dev/shm are sampled. FOLDER/soak.md holds the table, FOLDER/soak.json everything, the samples of each minute too.
"""

from __future__ import annotations

import csv
import json
import math
import os
import shutil
import signal
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.command import audited, tuberline
from benchmarks.options import above_zero, parser_of
from benchmarks.proc import TICKS_PER_S, parent_of, stat_fields
from benchmarks.soak_verdict import MEASURES, WARM_UP_S, Growth, RoleVerdict, Sample, line_verdict, role_verdict, worst
from conveyor.config import dump_toml
from conveyor.config_camera import CameraConfig
from tuberline.processes import line_processes
from tuberline.replayer import prepare_out, recording_cameras, replay_config
from tuberline.supervisor import ProcessSpec, Supervisor

SAMPLE_S = 5.0
ROLES = ("camera", "segmenter", "regressor", "aggregator", "router")
"""The first process of each is killed in turn."""


@dataclass(slots=True)
class Watch:
    """What was seen of the line."""

    samples: dict[str, list[Sample]] = field(default_factory=lambda: defaultdict(list))
    shm_files: list[int] = field(default_factory=list)
    kills: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    restarts: dict[str, int] = field(default_factory=dict)

    def look(self, supervisor: Supervisor, specs: Sequence[ProcessSpec], at_s: float) -> None:
        """Sample every process and /dev/shm."""
        self.shm_files.append(sum(1 for _ in Path("/dev/shm").iterdir()))
        for spec in specs:
            if (pid := supervisor.pid(spec.name)) is not None and (seen := sample(pid, at_s)):
                self.samples[spec.name].append(seen)
        parent = parent_of(supervisor.pid(specs[0].name))
        if parent not in (None, os.getpid()) and (seen := sample(parent, at_s)):
            self.samples["forks"].append(seen)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the line and tell what was measured; 1 where the books do not balance or something grows."""
    parser = parser_of("soak", __doc__)
    parser.add_argument("--minutes", type=above_zero, default=30.0)
    parser.add_argument("--kill-every-s", type=above_zero, default=60.0)
    parser.add_argument("--warm-up-s", type=float, default=WARM_UP_S, help="age at which a process counts; busy: more")
    parser.add_argument("--recording", type=Path, help="folder recording to repeat; default: a simulated one")
    parser.add_argument("--out", type=Path, help="keep ledger, logs, soak.md and soak.json here")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        recording = options.recording or simulated(Path(folder) / "belt")
        looped = loop(recording, Path(folder) / "looped", for_s=options.minutes * 60 + 60)
        out = options.out or Path(folder) / "out"
        watch = soak(looped, out, for_s=options.minutes * 60, kill_every_s=options.kill_every_s)
        books = read_books(out)
        report = told(watch, books, minutes=options.minutes, warm_up_s=options.warm_up_s)
        (out / "soak.json").write_text(json.dumps(report, indent=1) + "\n")
        (out / "soak.md").write_text(markdown(report))
        print((out / "soak.md").read_text())
    return 0 if books["balanced"] and report["verdict"] != "grows" else 1


def simulated(path: Path) -> Path:
    """A few seconds of belt."""
    tuberline("simulate", "--out", path, "--seed", "11", "--scene", "touching", "--tubers", "60", "--fps", "15")
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
                    same_file(source / "depth" / f"{old:06d}.png", target / "depth" / f"{seq:06d}.png")
                    seq += 1
    if (recording / "line.json").is_file():
        shutil.copy(recording / "line.json", into)
    return into


def same_file(source: Path, target: Path) -> None:
    """The same bytes by a hard link, or a copy on another disk (a recording refuses links that leave it)."""
    try:
        os.link(source.resolve(), target)
    except OSError:
        shutil.copyfile(source, target)


def soak(
    recording: Path,
    out: Path,
    *,
    for_s: float,
    kill_every_s: float = math.inf,
    speed: float = 1.0,
    copies: int = 1,
    regressors: int = 2,
    by_the_clock: bool = False,
) -> Watch:
    """Run a live line on `recording` and kill one process of each role in turn.

    Args:
        copies: cameras that play each camera of the recording.
        by_the_clock: what a camera does not take in time is gone, as with a device; else it falls behind, until all of
            its frames are too old.
    """
    prepare_out(out)
    names = recording_cameras(recording)
    played: dict[str, Any] = {"path": str(recording.resolve()), "speed": speed, "waits": False}
    if by_the_clock:
        played["starts_at_s"] = time.time()
    cameras = {f"{name}{n or ''}": {**played, "camera": name} for name in names for n in range(copies)}
    config = replay_config(
        recording,
        names,
        out=out,
        speed=speed,
        weights=None,
        regressors=regressors,
        rrd=None,
        settings={"segmenter": {"weigh_deadline_s": 60.0}, "aggregator": {"camera_stall_s": 10.0}},
    )
    config = config.model_copy(update={"cameras": {name: CameraConfig(**one) for name, one in cameras.items()}})
    config_path = out / "line.toml"
    config_path.write_text(dump_toml(config))
    specs = line_processes(config, config_path=config_path, run="soak")
    victims = [next(spec.name for spec in specs if spec.args[0] == role) for role in ROLES]
    watch = Watch()
    with Supervisor(specs, log_dir=out / "logs") as supervisor:
        started = time.monotonic()
        kill_due, sample_due = started + kill_every_s, started
        while (now := time.monotonic()) < started + for_s:
            supervisor.poll()
            if now >= kill_due:
                kill_due += kill_every_s
                victim = victims[sum(watch.kills.values()) % len(victims)]
                if (pid := supervisor.pid(victim)) is not None:
                    os.kill(pid, signal.SIGKILL)
                    watch.kills[victim] += 1
            if now >= sample_due:
                sample_due += SAMPLE_S
                watch.look(supervisor, specs, now - started)
            time.sleep(0.2)
        watch.restarts = dict(supervisor.restarts)
    return watch


def sample(pid: int, at_s: float) -> Sample | None:
    """Look at a process; None where it has just gone."""
    try:
        memory, status = _table(f"/proc/{pid}/smaps_rollup"), _table(f"/proc/{pid}/status")
        own_kib = int(memory["Private_Clean"].split()[0]) + int(memory["Private_Dirty"].split()[0])
        share_kib = int(memory["Pss"].split()[0])
        started_s = int(stat_fields(pid)[19]) / TICKS_PER_S
        descriptors = len(os.listdir(f"/proc/{pid}/fd"))
        uptime_s = float(Path("/proc/uptime").read_text().split()[0])
        age_s = uptime_s - started_s
        return Sample(at_s, age_s, pid, own_kib / 1024, share_kib / 1024, descriptors, int(status["Threads"]))
    except (OSError, KeyError, IndexError):
        return None


def _table(file: str) -> dict[str, str]:
    return dict(line.split(":", 1) for line in Path(file).read_text().splitlines() if ":" in line)


def told(watch: Watch, books: dict[str, Any], *, minutes: float, warm_up_s: float) -> dict[str, Any]:
    """Everything that was measured, as plain values."""
    found = {name: role_verdict(name, seen, warm_up_s=warm_up_s) for name, seen in watch.samples.items()}
    roles = [verdict for verdict in found.values() if verdict]
    line = line_verdict(dict(watch.samples), warm_up_s=warm_up_s)
    shm = watch.shm_files
    return {
        "minutes": minutes,
        "warm_up_s": warm_up_s,
        "verdict": worst(verdict.word for verdict in roles),  # the sum of many is told: its limit is that of one
        "line_mib": asdict(line) if line else None,
        "kills": dict(watch.kills),
        "restarts": watch.restarts,
        "shm_files": {"first": shm[0], "last": shm[-1], "most": max(shm)},
        "roles": [verdict.as_dict() for verdict in roles],
        "rows": [_row(verdict, watch.restarts.get(verdict.name, 0)) for verdict in roles],
        "never_settled": [name for name, verdict in found.items() if verdict is None],
        "books": books,
        "per_minute": {name: per_minute(seen) for name, seen in watch.samples.items()},
    }


def per_minute(seen: Sequence[Sample]) -> list[dict[str, float]]:
    """The first sample of each minute."""
    minutes: dict[int, Sample] = {}
    for one in seen:
        minutes.setdefault(int(one.at_s // 60), one)
    return [{"minute": minute, **asdict(one)} for minute, one in sorted(minutes.items())]


def _row(verdict: RoleVerdict, restarts: int) -> str:
    memory, fds, threads = (
        f"{verdict.first[m]:.0f}, {verdict.last[m]:.0f}, {verdict.most[m]:.0f}" for m in MEASURES
    )  # fmt: skip
    lives = ", ".join(f"{g.per_h:+.0f}" for life in verdict.per_life if (g := life["own_mib"])) or "too short"
    return (
        f"| {verdict.name} | {restarts} | {memory} | {_slope(verdict.pooled['own_mib'])} | {lives} | {fds} | {threads} "
        f"| {verdict.word} |"
    )


def _slope(growth: Growth | None) -> str:
    if growth is None:
        return "too short"
    late = growth.late and "; last half {:+.0f} ({:+.0f} to {:+.0f})".format(*growth.late)
    return f"{growth.per_h:+.0f} ({growth.low_per_h:+.0f} to {growth.high_per_h:+.0f}){late or ''}"


def markdown(report: dict[str, Any]) -> str:
    """The report for people."""
    books, shm, line = report["books"], report["shm_files"], report["line_mib"]
    whole = "too short to tell" if line is None else f"{_slope(Growth(**line))} MiB/h: {line['verdict']}"
    rows = [
        f"{report['minutes']:g} minutes, {sum(report['kills'].values())} kills; verdict: **{report['verdict']}**. "
        f"All processes together: {whole}. Files in /dev/shm: {shm['first']} at the start, {shm['last']} at the end, "
        f"{shm['most']} at most.",
        "",
        "| process | restarts | own MiB first, last, most | growth MiB/h (95 %) | in each life | descriptors | threads "
        "| verdict |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
        *report["rows"],
        *(f"| {name} | | never lived long enough | | | | | unclear |" for name in report["never_settled"]),
        "",
        f"Audit: {'balanced' if books['balanced'] else 'NOT BALANCED'}; tracks {books['tracks']}.",
    ]
    for camera, sheet in books["cameras"].items():
        rows.append(f"{camera}: frames {sheet['frames']}; views {sheet['views']}; tracks {sheet['tracks']}.")
    rows.append(f"Ledger {books['ledger_kib']:.0f} KiB, track logs {books['track_logs_kib']:.0f} KiB.")
    return "\n".join(rows) + "\n"


def read_books(out: Path) -> dict[str, Any]:
    """The audit of what was counted, and what lies on the disk."""
    return {
        **audited(out),
        "ledger_kib": sum(file.stat().st_size for file in out.glob("ledger.db*")) / 1024,
        "track_logs_kib": sum(file.stat().st_size for file in (out / "state").glob("*")) / 1024,
    }
