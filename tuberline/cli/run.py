"""`tuberline run`: all processes of a line on this machine."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from conveyor.config import LineConfig, load_config
from conveyor.errors import ConfigError, InputError, TuberlineError
from conveyor.files import cause, may_pass
from conveyor.observer import observer_when_there
from conveyor.signals import stop_when_told
from conveyor.taken_port import check_port_free
from conveyor.topics import check_name
from tuberline.cli.named_files import check_access, unreadable_files
from tuberline.processes import line_processes
from tuberline.supervisor import Supervisor

LOOK_EVERY_S = 0.2
CLOCK_SLACK_S = 1.0
"""Of a disk's clock against this machine's."""


def run(config: Path, *, run: str | None = None, no_router: bool = False, logs: Path | None = None) -> None:
    """Run a line until stopped, restarting whatever crashes. Ends by itself where no camera is left that could be
    counted, and with its load where `aggregator.exit_when_final` is set.

    Parameters
    ----------
    config
        The line's TOML file.
    run
        Id of this run; default: the time of its start. Give the old one to go on with it.
    no_router
        The router runs elsewhere.
    logs
        Folder for the nodes' logs; default: this terminal, or the aggregator's out folder when it shows the live table.

    Raises
    ------
    ConfigError
        A file that it names cannot be used, its recording lacks a camera, or its router would refuse it.
    InputError
        The folder of the ledger or of the logs cannot be made.
    LedgerError
        The run of that id is finished, or was begun with other cameras.
    TakenError
        Another router listens on the line's port; the text says who.
    """
    line = load_config(config)
    if not line.cameras:
        raise TuberlineError(f"config {config} names no camera; add a section [cameras.<name>] with a path or a source")
    if not no_router:
        check_access(line, config)
    if faults := unreadable_files(line):
        raise ConfigError(f"config {config}: {'; '.join(faults)}; the line would go without these, or count nothing")
    if run is not None:
        check_name(run, what="run")
        from aggregator.ledger.goes_on import check_run_goes_on

        ledger, again = line.aggregator.out / "ledger.db", not line.aggregator.exit_when_final
        check_run_goes_on(ledger, run, cameras=list(line.cameras), may_be_finished=again)
    _make_folders({"aggregator.out": line.aggregator.out, "--logs": logs})
    run_id = run or datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    shown = sys.stderr.isatty()
    stop = threading.Event()
    specs = line_processes(line, config_path=config.resolve(), run=run_id, router=not no_router)
    log_dir = logs or (line.aggregator.out / "logs" if shown else None)
    if not no_router:
        check_port_free(line.link)
    with Supervisor(specs, log_dir=log_dir) as supervisor:  # a signal that comes while it starts nodes breaks into that
        stop_when_told(stop)
        if shown:
            _show(supervisor, line, stop)
        while not (stop.wait(LOOK_EVERY_S) or supervisor.finished("aggregator")):
            raise_if_pointless(supervisor)
        stopped_s, complete = time.time(), supervisor.finished("aggregator")
    if not complete:
        summarise_late(line, run_id, stopped_s)


def _make_folders(folders: Mapping[str, Path | None]) -> None:
    """Make them before anything starts; what a disk refuses that may take it later is left to who needs it.

    Raises:
        InputError: one cannot be made, ever; named by its key or option.
    """
    for name, folder in folders.items():
        try:
            if folder is not None:
                folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            if not may_pass(error):
                raise InputError(f"folder {folder} ({name}) cannot be made: {cause(error)}") from error


def summarise_late(line: LineConfig, run: str, stopped_s: float) -> None:
    """An aggregator that was down when the line was stopped left no summary, or an old one: make it from the ledger.

    Args:
        stopped_s: when that was, seconds since 1970.
    """
    from aggregator.late_summary import write_late_summary

    out = line.aggregator.out
    summary = out / "summary.json"
    if summary.is_file() and (summary.stat().st_mtime >= stopped_s - CLOCK_SLACK_S or _is_final(summary, run)):
        return
    told = f"tuberline: the aggregator of run {run} was down when the line was stopped: "
    try:
        if write_late_summary(line, run, stopped_s=stopped_s):
            told += f"{summary} is made from its ledger, what had not come to it counts as not seen"
        else:
            told += f"there is no summary, for {out} holds nothing of it"
    except TuberlineError as error:
        told += f"there is no summary: {error}"
    sys.stderr.write(f"{told}; `tuberline run --run {run}` goes on with it\n")


def _is_final(summary: Path, run: str) -> bool:
    """Whether it tells of this run, and that all of it is counted: it was written then, however long ago."""
    try:
        told = json.loads(summary.read_text(encoding="utf-8"))
        return told["run"] == run and bool(told["final"])
    except (OSError, ValueError, KeyError, TypeError):
        return False


def raise_if_pointless(supervisor: Supervisor) -> None:
    """A line without its router, without a single camera that is counted, or without a single node, is not kept up.

    A camera is not counted where it gave up, or its segmenter did.

    Raises:
        TuberlineError: so it is; with the last words of those that gave up, and the exit code of the first.
    """
    failures = supervisor.failures
    nodes = set(supervisor.restarts) - {"router", "alarms"}
    cameras = {name.removeprefix("camera-") for name in nodes if name.startswith("camera-")}
    lost = {camera for camera in cameras if {f"camera-{camera}", f"segmenter-{camera}"} & set(failures)}
    if "router" in failures or nodes <= set(failures) or (cameras and cameras == lost):
        said = "\n".join(f"  {name}: {supervisor.last_words(name) or 'see above'}" for name in failures)
        error = TuberlineError(f"the line is not kept up: {', '.join(failures)} gave up\n{said}")
        error.exit_code = next(iter(failures.values()))
        raise error


def _show(supervisor: Supervisor, config: LineConfig, stop: threading.Event) -> None:
    """The live table, until stopped, or until its terminal is closed: under nohup the line goes on.

    Drawn by this thread: one that fails to draw would end the process, and with it the line.
    """
    from rich.live import Live

    from tuberline.cli.live import line_table

    def check() -> None:
        raise_if_pointless(supervisor)
        if stop.is_set():
            raise SystemExit(0)

    with (
        suppress(OSError),
        observer_when_there(config.link, line=config.name, meanwhile=check) as observer,
        Live(auto_refresh=False) as live,
    ):
        while not (stop.wait(LOOK_EVERY_S) or supervisor.finished("aggregator")):
            raise_if_pointless(supervisor)
            live.update(line_table(observer.totals(), observer.nodes(), alive=observer.alive()), refresh=True)
