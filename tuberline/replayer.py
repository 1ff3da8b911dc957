"""The whole line on a recording: real processes, embedded defaults, until everything is counted."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aggregator.ledger.files import write_whole
from conveyor.belt_findings import belt_findings, found_so_far
from conveyor.config import REPLAY_NAME, LineConfig, dump_toml, load_config, parse_config
from conveyor.contract import read_contract
from conveyor.errors import InputError, LinkError, OutputError, StorageError, TuberlineError
from conveyor.files import cause, fault_of, unwritable, whole_output
from conveyor.observer import Observer, observer_when_there
from conveyor.processors import usable
from conveyor.stated import level_fault
from conveyor.taken_port import check_port_free, free_port
from tuberline.places import LIES, belt_in, hung_together, places_in
from tuberline.processes import line_processes, usual_regressors
from tuberline.recorded import has_positions, lost_frames, none_counted, other_zeros
from tuberline.supervisor import Supervisor

if TYPE_CHECKING:
    from conveyor.formats.source import CameraDescription
    from tuberline.cli.replay_table import Show
    from tuberline.forks import ForkServer

QUIET_LIMIT_S = 90.0
START_LIMIT_S = 120.0
COMING_UP_LIMIT_S = 600.0
"""Without movement, in which no process waited for a processor. First use compiles, for minutes on a small machine."""
CONFIG_FILE, RUN_FILE = "line.toml", "run"
"""In the folder of the results: the effective config, and the id of the run."""
FAST: dict[str, dict[str, Any]] = {"segmenter": {"views_per_tuber": 1}, "regressor": {"precision": "fastest"}}
"""Sections of a replay that weighs as a busy live line does."""
MOVES = ("frames_looked_first", "frames_processed", "entries_applied")
"""Counters of nodes that say that a replay goes on."""
MOST_CRASHES = 6
"""A node that crashed so often will not get through this recording."""


def replay_recording(
    recording: Path,
    *,
    out: Path,
    speed: float = 0.0,
    weights: Path | None = None,
    regressors: int | None = None,
    rrd: Path | None = None,
    ignore_masks: bool = False,
    resting_offset_mm: float | None = None,
    resting_sd_mm: float | None = None,
    contract: Path | None = None,
    places: Path | None = None,
    fast: bool = False,
    show: bool = False,
    settings: Mapping[str, Any] | None = None,
    forks: ForkServer | None = None,
) -> dict[str, Any]:
    """Run the graph on `recording` until every camera ended and the summary is written; returns the summary.

    Args:
        regressors: number of weighing processes; None: `usual_regressors`.
        resting_offset_mm, resting_sd_mm: how far tubers' undersides lie below the belt, and how well that is known;
            None: what the recording states.
        contract: a buyer's classes of size (TOML).
        places: a line's file that says where the cameras hang, and in `[belt]` what tubers lie on, instead of what the
            recording says.
        fast: one view of a tuber from each camera, in the fastest form within 0.1 g of the exact one.
        settings: further config sections by name, e.g. {"segmenter": {"views_per_tuber": 5}}.
        forks: the process that nodes are forked from, where it was begun earlier.

    Raises:
        InputError: recording or weights unusable, or `out` already holds a run.
        TuberlineError: a node gave up; the text carries its last words.
    """
    from conveyor.formats import open_source
    from conveyor.formats.inspection import told_at_once

    if regressors is not None and regressors < 1:
        raise InputError(f"--regressors {regressors}: at least 1 is needed to weigh anything")
    cameras = recording_cameras(recording, ignore_masks=ignore_masks)
    _refuse_early(weights, contract)
    told = [open_source(recording, camera=name, ignore_masks=ignore_masks).description for name in cameras]
    belt = belt_said(belt_in(places) if places else {}, told, offset_mm=resting_offset_mm, sd_mm=resting_sd_mm)
    sections: dict[str, Any] = {"belt": belt, **(settings or {})}
    asked = FAST if fast else {}
    sections |= {name: {**section, **sections.get(name, {})} for name, section in asked.items()}
    if contract is not None:
        sections["aggregator"] = {**sections.get("aggregator", {}), "contract": str(contract.resolve())}
    config = replay_config(
        recording,
        cameras,
        out=out,
        speed=speed,
        weights=weights,
        regressors=regressors or usual_regressors(usable()),
        rrd=rrd,
        settings=sections,
        ignore_masks=ignore_masks,
        places=places_in(places, cameras) if places else None,
    )
    prepare_out(out)
    take_positions(recording, out)
    run = run_id(recording)
    _keep(config, out=out, run=run)
    notes = [*told_at_once(recording, masks=not ignore_masks), *hung_together(told, config.cameras)]
    return _count(config, out=out, run=run, show=show, forks=forks, notes=notes)


def _keep(config: LineConfig, *, out: Path, run: str) -> None:
    """Write down what is begun, so that it can be resumed; nothing stays where that cannot be written."""
    try:
        write_whole(out / CONFIG_FILE, dump_toml(config))
        write_whole(out / RUN_FILE, run + "\n")
    except StorageError:
        with suppress(OSError):
            (out / CONFIG_FILE).unlink(missing_ok=True)
            out.rmdir()
        raise


def _refuse_early(weights: Path | None, contract: Path | None) -> None:
    """What no process could use is refused in a sentence, before anything is written or started."""
    if contract is not None:
        read_contract(contract)
    if weights is not None:
        from regressor.network.stored import load_weights

        load_weights(weights)


def resume_replay(recording: Path, *, out: Path, show: bool = False, forks: ForkServer | None = None) -> dict[str, Any]:
    """Go on with the replay of `recording` into `out` that was cut short, with the settings it was started with.

    Raises:
        InputError: there is none in `out`, or it is of another recording.
        TakenError: it is still running.
        TuberlineError: a node gave up; the text carries its last words.
    """
    started = out / RUN_FILE
    if not started.is_file():
        raise InputError(f"--resume: {out} holds no replay that was begun; leave --resume out to begin one")
    run, wanted = started.read_text(encoding="utf-8").strip(), run_id(recording)
    if run != wanted:
        raise InputError(f"--resume: {out} was begun with another recording ({run}); {recording} is {wanted}")
    config = load_config(out / CONFIG_FILE)
    check_port_free(config.link)
    if _finished(out, run):
        return _summary(out)
    link = config.link.model_copy(update={"router": f"tcp/127.0.0.1:{free_port()}"})
    config = config.model_copy(update={"link": link})
    write_whole(out / CONFIG_FILE, dump_toml(config))
    return _count(config, out=out, run=run, show=show, forks=forks)


def run_id(recording: Path) -> str:
    """Id of the run that replays `recording`: the same one for the same recording."""
    return f"replay-{fingerprint(recording)}"


def _finished(out: Path, run: str) -> bool:
    """The ledger holds the whole run, with its summary."""
    from aggregator.ledger.reader import read_run, reading

    if not (out / "ledger.db").is_file() or not (out / "summary.json").is_file():
        return False
    with reading(out / "ledger.db") as db:
        row = read_run(db, run)
    return row is not None and row.finished


def _count(
    config: LineConfig, *, out: Path, run: str, show: bool, forks: ForkServer | None, notes: Sequence[str] = ()
) -> dict[str, Any]:
    """Run the line until it has counted everything; its summary. `notes`: what is to be known of the recording."""
    positions, unusable = has_positions(out, run=run)
    specs = line_processes(config, config_path=(out / CONFIG_FILE).resolve(), run=run, positions=positions)
    with Supervisor(specs, log_dir=out / "logs", forks=forks) as supervisor:
        findings = [*notes, *unusable, *_wait_until_counted(supervisor, config, show=show)]
    summary = _summary(out)
    findings += lost_frames(summary["cameras"], logs=out / "logs") + none_counted(summary)
    findings += other_zeros(out, run=run, totals=summary["totals"])
    restarts = {name: n for name, n in supervisor.restarts.items() if n}
    if restarts:
        summary["restarts"] = restarts
    if findings:
        summary["findings"] = findings
    return summary


def _summary(out: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    return summary


def recording_cameras(recording: Path, *, ignore_masks: bool = False) -> list[str]:
    """Names of the cameras in a recording of any known format, refused before anything is started or written where it
    cannot be used.
    """
    from conveyor.formats.cameras import check_readable

    return check_readable(recording, ignore_masks=ignore_masks)


def prepare_out(out: Path) -> None:
    """Make the result folder; refuse one that already holds a run, for its ledger would count everything twice."""
    ledger = out / "ledger.db"
    if ledger.exists():
        raise InputError(
            f"{ledger} already holds a run; give another --out, remove that folder first, or go on with it by --resume"
        )
    made = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise fault_of(error, f"--out {out} cannot be made: {cause(error)}") from error
    if trouble := unwritable(out):
        if made:
            out.rmdir()
        raise OutputError(f"--out {out} cannot be written: {trouble}")


def take_positions(recording: Path, out: Path) -> None:
    """The machine's positions, where the recording has them: its frames keep their times, so a map finds the tubers."""
    from conveyor.formats.beside import recording_files
    from conveyor.formats.positions import POSITIONS_FILE

    positions = recording_files(recording).get(POSITIONS_FILE)
    if positions is not None:
        with whole_output(out / POSITIONS_FILE) as part:
            part.write_bytes(positions)


def belt_said(
    file: Mapping[str, Any], cameras: Iterable[CameraDescription], *, offset_mm: float | None, sd_mm: float | None
) -> dict[str, Any]:
    """Section `belt` of a replay: as a line's file has it, with the resting level as given, else as the file says it,
    else as a recording's cameras state it.
    """
    return {**file, **stated_belt(() if LIES & file.keys() else cameras, offset_mm=offset_mm, sd_mm=sd_mm)}


def stated_belt(
    cameras: Iterable[CameraDescription], *, offset_mm: float | None = None, sd_mm: float | None = None
) -> dict[str, float]:
    """Section `belt` of a line: the resting level as given, else as a recording's cameras state it, in the mean; 0
    where that is less than can be known, which `described_doubtfully` tells.
    """
    told = [(d.resting_offset_mm, d.resting_sd_mm) for d in cameras]
    stated = [(offset or 0.0, sd) for offset, sd in told if (offset, sd) != (None, None)]
    if offset_mm is None and stated:
        offset_mm = sum(offset for offset, _ in stated) / len(stated)
        known = [sd for _, sd in stated if sd is not None]
        sd_mm = max(known, default=None) if sd_mm is None else sd_mm
        offset_mm, sd_mm = (0.0 if value and level_fault(value) else value for value in (offset_mm, sd_mm))
    values = {"resting_offset_mm": offset_mm, "resting_sd_mm": sd_mm}
    return {key: value for key, value in values.items() if value is not None}


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
    places: Mapping[str, Mapping[str, Any]] | None = None,
) -> LineConfig:
    """The line that replays `recording`: embedded defaults, a router on a free port of this machine."""
    raw: dict[str, Any] = {
        "name": REPLAY_NAME,
        "link": {"router": f"tcp/127.0.0.1:{free_port()}", "connect_timeout_s": 60.0},
        "cameras": {
            n: {"path": str(recording.resolve()), "speed": speed, **(places or {}).get(n, {})} for n in cameras
        },
        # A busy machine or a cut link must not decide how many views a tuber of the same recording gets.
        "segmenter": {"state_dir": str(out.resolve() / "state"), "weigh_deadline_s": 600.0, "look_first": True},
        "regressor": {"processes": regressors, "state_dir": str(out.resolve() / "weights")},
        # A replay waits for everybody, so a silent camera is one that is being restarted: no one goes on without it.
        "aggregator": {"out": str(out.resolve()), "exit_when_final": True, "camera_stall_s": 600.0},
    }
    if ignore_masks:
        for camera in raw["cameras"].values():
            camera["ignore_masks"] = True
    if weights is not None:
        raw["regressor"]["weights"] = str(weights.resolve())
    if rrd is not None:
        raw["viewer"] = {"rrd": str(rrd.resolve())}
    for section, values in (settings or {}).items():
        raw[section] = {**raw.get(section, {}), **values}
    return parse_config(raw, where="of this replay")


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
    showing: AbstractContextManager[Show | None] = nullcontext()
    if show:
        from tuberline.cli.replay_table import replay_table

        showing = replay_table(_frames(config))
    out = config.aggregator.out
    observing = observer_when_there(
        config.link, line=config.name, meanwhile=lambda: _raise_failures(supervisor, out), within_s=START_LIMIT_S
    )
    with observing as observer, showing as table:
        moved, last = supervisor.own_time_s, -1
        findings: dict[str, dict[str, str]] = {}
        while not supervisor.finished("aggregator"):
            _raise_failures(supervisor, out)
            nodes = observer.nodes()
            for name, counters in nodes.items():
                told = belt_findings(counters.name, counters.gauges) if counters.role == "segmenter" else {}
                findings[name] = found_so_far(findings.get(name, {}), told)
            done = sum(sum(map(n.count, MOVES)) for n in nodes.values())
            if done != last:
                moved, last = supervisor.own_time_s, done
            limit_s = QUIET_LIMIT_S if done else _start_limit_s(supervisor, observer)
            if supervisor.own_time_s - moved > limit_s:
                raise LinkError(_stands_still(supervisor, config, limit_s))
            if table is not None:
                table(observer.totals(), nodes, observer.alive())
            time.sleep(0.1)
        return [text for found in findings.values() for text in found.values()]


def _start_limit_s(supervisor: Supervisor, observer: Observer) -> float:
    """Longer while a node is on its way up for the first time. The router has no token."""
    coming = not any(supervisor.restarts.values()) and len(observer.alive()) < len(supervisor.restarts) - 1
    return COMING_UP_LIMIT_S if coming else START_LIMIT_S


def _frames(config: LineConfig) -> int | None:
    """How many frames the recording of the replay has; None where that is not known before all are read."""
    from conveyor.formats import open_source

    paths = {name: camera.path for name, camera in config.cameras.items()}
    counts = [open_source(Path(path), camera=name).description.frames for name, path in paths.items() if path]
    return None if None in counts else sum(count or 0 for count in counts)


def _stands_still(supervisor: Supervisor, config: LineConfig, limit_s: float) -> str:
    down = [name for name in supervisor.restarts if supervisor.pid(name) is None and not supervisor.finished(name)]
    said = "".join(f"\n{name} last said: {supervisor.last_words(name)}" for name in down)
    return (
        f"nothing moved for {limit_s:g} s; the nodes' logs are in {config.aggregator.out / 'logs'}; "
        f"--resume goes on from here{said}"
    )


def _raise_failures(supervisor: Supervisor, out: Path) -> None:
    if supervisor.stumbled and (trouble := unwritable(out)):
        names = ", ".join(sorted(supervisor.stumbled))
        raise StorageError(
            f"{names} can write nothing more into {out}: {trouble}; then --resume goes on, nothing counted is lost"
        )
    for name, crashes in supervisor.crashes.items():
        if crashes >= MOST_CRASHES:
            raise TuberlineError(f"{name} crashed {crashes} times; it last said:\n{supervisor.log_tail(name)}")
    for name, code in supervisor.failures.items():
        raise TuberlineError(f"{name} gave up (exit code {code}): {supervisor.last_words(name)}")
