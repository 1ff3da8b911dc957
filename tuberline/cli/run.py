"""`tuberline run`: all processes of a line on this machine."""

from __future__ import annotations

import signal
import sys
import threading
from datetime import UTC, datetime
from pathlib import Path

from conveyor.config import load_config
from conveyor.errors import TuberlineError
from conveyor.observer import Observer
from tuberline.processes import line_processes
from tuberline.supervisor import Supervisor


def run(config: Path, *, run: str | None = None, no_router: bool = False, logs: Path | None = None) -> None:
    """Run a line until stopped, restarting whatever crashes.

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
    """
    line = load_config(config)
    if not line.cameras:
        raise TuberlineError(f"config {config} names no camera; add a section [cameras.<name>] with a path or a source")
    run_id = run or datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    shown = sys.stderr.isatty()
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    specs = line_processes(line, config_path=config.resolve(), run=run_id, router=not no_router)
    log_dir = logs or (line.aggregator.out / "logs" if shown else None)
    with Supervisor(specs, log_dir=log_dir) as supervisor:
        if not shown:
            while not stop.wait(0.2):
                supervisor.poll()
            return
        from rich.live import Live

        from tuberline.cli.live import line_table

        with Observer(line.link, line=line.name) as observer, Live(refresh_per_second=4) as live:
            while not stop.wait(0.2):
                supervisor.poll()
                live.update(line_table(observer.totals(), observer.nodes(), alive=observer.alive()))
