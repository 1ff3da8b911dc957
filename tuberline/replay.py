"""`tuberline replay`: the whole graph on a recording, real processes, embedded defaults."""

from __future__ import annotations

import hashlib
import json as json_module
import socket
import sys
import time
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from conveyor.belt_findings import belt_findings
from conveyor.config import LineConfig, dump_toml, parse_config
from conveyor.errors import InputError, LinkError, TuberlineError
from conveyor.observer import Observer
from tuberline.processes import line_processes
from tuberline.supervisor import Supervisor

QUIET_LIMIT_S = 90.0
START_LIMIT_S = 120.0
MOST_RESTARTS = 6
"""A node that crashed so often will not get through this recording."""


def replay(
    recording: Path,
    /,
    *,
    out: Path,
    speed: str = "max",
    weights: Path | None = None,
    regressors: int = 2,
    rrd: Path | None = None,
    ignore_masks: bool = False,
    json: bool = False,
) -> None:
    """Count and weigh everything in a recording. Writes ledger.db, summary.json and tubers.csv.

    Parameters
    ----------
    recording
        Folder, .mcap file or 3DPotatoTwin folder; all its cameras are used.
    out
        Folder for the results; it must not hold a run yet.
    speed
        real, max, or a factor such as 2.5. Nothing is lost at any speed: a replay waits for the line.
    weights
        PointRAFT weights (.safetensors or the authors' .pth); default: the shipped ones.
    regressors
        Number of weighing processes.
    rrd
        Also write a Rerun recording to this file.
    ignore_masks
        Find the tubers on depth though the recording has masks of its own.
    json
        Print the summary as JSON on stdout.
    """
    summary = replay_recording(
        recording,
        out=out,
        speed=parse_speed(speed),
        weights=weights,
        regressors=regressors,
        rrd=rrd,
        ignore_masks=ignore_masks,
        show=not json,
    )
    if json:
        sys.stdout.write(json_module.dumps(summary, indent=2) + "\n")
    else:
        from rich.console import Console

        from tuberline.cli.report import print_summary

        print_summary(Console(), summary, out=out)
    if summary["state"] == "nothing seen":
        raise TuberlineError(f"nothing was seen of {recording}: {summary['reason']}")


def parse_speed(text: str) -> float:
    """Times real time; 0 means as fast as the line takes it."""
    if text in ("max", "real"):
        return 0.0 if text == "max" else 1.0
    try:
        factor = float(text)
    except ValueError:
        factor = -1.0
    if not 0 < factor < 1000:
        raise InputError(f"--speed {text}: give real, max or a factor above 0 and below 1000")
    return factor


def replay_recording(
    recording: Path,
    *,
    out: Path,
    speed: float = 0.0,
    weights: Path | None = None,
    regressors: int = 2,
    rrd: Path | None = None,
    ignore_masks: bool = False,
    show: bool = False,
    settings: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Run the graph on `recording` until every camera ended and the summary is written; returns the summary.

    Args:
        settings: further config sections by name, e.g. {"segmenter": {"views_per_tuber": 5}}.

    Raises:
        InputError: recording or weights unusable, or `out` already holds a run.
        TuberlineError: a node gave up; the text carries its last words.
    """
    if regressors < 1:
        raise InputError(f"--regressors {regressors}: at least 1 is needed to weigh anything")
    cameras = recording_cameras(recording)
    prepare_out(out)
    config = replay_config(
        recording,
        cameras,
        out=out,
        speed=speed,
        weights=weights,
        regressors=regressors,
        rrd=rrd,
        settings=settings,
        ignore_masks=ignore_masks,
    )
    config_path = out.resolve() / "line.toml"
    config_path.write_text(dump_toml(config), encoding="utf-8")
    specs = line_processes(config, config_path=config_path, run=f"replay-{fingerprint(recording)}")
    with Supervisor(specs, log_dir=out / "logs") as supervisor:
        findings = _wait_until_counted(supervisor, config, show=show)
    summary: dict[str, Any] = json_module.loads((out / "summary.json").read_text(encoding="utf-8"))
    restarts = {name: n for name, n in supervisor.restarts.items() if n}
    if restarts:
        summary["restarts"] = restarts
    if findings:
        summary["findings"] = findings
    return summary


def recording_cameras(recording: Path) -> list[str]:
    """Names of the cameras in a recording of any known format. Each camera's first frame is read, so that a recording
    that cannot be used is refused before anything is started or written.
    """
    from conveyor.formats import camera_names, open_source

    names = list(camera_names(recording))
    for name in names:
        next(iter(open_source(recording, camera=name).frames(run="check")), None)
    return names


def prepare_out(out: Path) -> None:
    """Make the result folder; refuse one that already holds a run, for its ledger would count everything twice."""
    ledger = out / "ledger.db"
    if ledger.exists():
        raise InputError(f"{ledger} already holds a run; give another --out, or remove that folder first")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out} cannot be made: {error.strerror or error}") from error


def replay_config(
    recording: Path,
    cameras: list[str],
    *,
    out: Path,
    speed: float,
    weights: Path | None,
    regressors: int,
    rrd: Path | None,
    settings: Mapping[str, Any] | None,
    ignore_masks: bool = False,
) -> LineConfig:
    """The line that replays `recording`: embedded defaults, a router on a free port of this machine."""
    raw: dict[str, Any] = {
        "name": "replay",
        "link": {"router": f"tcp/127.0.0.1:{free_port()}", "connect_timeout_s": 60.0},
        "cameras": {name: {"path": str(recording.resolve()), "speed": speed} for name in cameras},
        # A busy machine or a cut link must not decide how many views a tuber of the same recording gets.
        "segmenter": {"state_dir": str(out.resolve() / "state"), "weigh_deadline_s": 600.0},
        "regressor": {"processes": regressors, "state_dir": str(out.resolve() / "weights")},
        # A replay waits for everybody, so a silent camera is one that is being restarted: nobody goes on without it.
        "aggregator": {"out": str(out.resolve()), "exit_when_final": True, "camera_stall_s": 600.0},
    }
    if ignore_masks:
        for camera in raw["cameras"].values():
            camera["ignore_masks"] = True
    if weights is not None:
        if not weights.is_file():
            raise InputError(f"--weights {weights} does not exist")
        raw["regressor"]["weights"] = str(weights.resolve())
    if rrd is not None:
        raw["viewer"] = {"rrd": str(rrd.resolve())}
    for section, values in (settings or {}).items():
        raw[section] = {**raw.get(section, {}), **values}
    return parse_config(raw, where="of this replay")


def free_port() -> int:
    """A TCP port of this machine that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def fingerprint(recording: Path) -> str:
    """12 hex digits that stay the same for the same recording: names and sizes of its files, text of its tables."""
    digest = hashlib.sha256()
    files = sorted(recording.rglob("*")) if recording.is_dir() else [recording]
    for file in files:
        if file.is_file():
            digest.update(f"{file.relative_to(recording.parent)} {file.stat().st_size}\n".encode())
            if file.suffix in (".csv", ".json") and file.name != "truth.json":
                digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def _wait_until_counted(supervisor: Supervisor, config: LineConfig, *, show: bool) -> list[str]:
    """Until the aggregator has written its summary; returns what is wrong with the belts. Raises when a node gave up or
    nothing moves any more.
    """
    from rich.console import Console
    from rich.live import Live

    from tuberline.cli.live import line_table

    live = Live(console=Console(stderr=True), refresh_per_second=4, transient=True) if show else nullcontext()
    with Observer(config.link, line=config.name) as observer, live as table:
        moved, last = time.monotonic(), -1
        findings: dict[str, str] = {}
        limit_s = START_LIMIT_S
        while not supervisor.finished("aggregator"):
            supervisor.poll()
            _raise_failures(supervisor)
            nodes = observer.nodes()
            for name, counters in nodes.items():
                told = belt_findings(counters.name, counters.gauges) if counters.role == "segmenter" else {}
                findings |= {f"{name} {finding}": text for finding, text in told.items()}
            done = sum(n.count("frames_processed") + n.count("entries_applied") for n in nodes.values())
            if done != last:
                limit_s = QUIET_LIMIT_S if last >= 0 and done else START_LIMIT_S
                moved, last = time.monotonic(), done
            if time.monotonic() - moved > limit_s:
                raise LinkError(
                    f"nothing moved for {limit_s:g} s; the nodes' logs are in {config.aggregator.out / 'logs'}"
                )
            if table is not None:
                table.update(line_table(observer.totals(), nodes, alive=observer.alive()))
            time.sleep(0.1)
        return list(findings.values())


def _raise_failures(supervisor: Supervisor) -> None:
    for name, restarts in supervisor.restarts.items():
        if restarts >= MOST_RESTARTS:
            raise TuberlineError(f"{name} crashed {restarts} times; it last said:\n{supervisor.log_tail(name)}")
    for name, code in supervisor.failures.items():
        tail = supervisor.log_tail(name)
        said = [line for line in tail.splitlines() if line.startswith("tuberline: ")]
        reason = tail[tail.index(said[-1]) + len("tuberline: ") :] if said else tail
        raise TuberlineError(f"{name} gave up (exit code {code}): {reason}")
