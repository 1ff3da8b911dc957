"""The nodes of a line as commands, one process each; segmenter and viewer have files of their own."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def camera(*, config: Path, camera: str, run: str | None = None) -> None:
    """Publish the frames of one camera of a line.

    Parameters
    ----------
    config
        The line's TOML file.
    camera
        Which of its cameras.
    run
        Id of this run; default: the time of its start. All nodes of a run need the same.
    """
    from camera_sim.node import run_camera
    from conveyor.config import load_config
    from conveyor.heap import keep_buffers

    keep_buffers()
    run_camera(load_config(config), camera, run or _new_run())


def recorder(*, config: Path, out: Path, run: str | None = None, name: str = "recorder") -> None:
    """Record the frames of all cameras of a running line to MCAP, until stopped. No process waits for it.

    Parameters
    ----------
    config
        The line's TOML file.
    out
        The file to write. Where it exists, or a camera begins another run, a new part is begun beside it: NAME-2.mcap.
        After a crash `tuberline recover` saves all but the last second.
    run
        Id of this run, for the counters only.
    name
        Name of this recorder on the line.
    """
    from camera_sim.recorder import run_recorder
    from conveyor.config import load_config

    for part in run_recorder(load_config(config), out, run=run or _new_run(), name=name):
        sys.stdout.write(f"{part.frames} frames in {part.path}\n")


def encoder(*, config: Path, run: str | None = None) -> None:
    """Read the encoder on the belt's shaft, and tell live cameras how far the belt has moved.

    Parameters
    ----------
    config
        The line's TOML file, with [encoder].
    run
        Id of this run; all nodes of a run need the same.
    """
    from camera_sim.encoder.node import run_encoder
    from conveyor.config import load_config

    run_encoder(load_config(config), run=run or _new_run())


def gnss(*, config: Path, run: str | None = None, recorded: bool = False) -> None:
    """Read the machine's GNSS receiver: positions onto the line and into positions.csv beside the ledger.

    Parameters
    ----------
    config
        The line's TOML file, with [gnss].
    run
        Id of this run.
    recorded
        Tell those that are in positions.csv beside the ledger, each when the cameras that replay the recording have
        come to its time. `tuberline replay` starts this; it needs no [gnss].
    """
    from camera_sim.gnss.node import run_gnss
    from camera_sim.gnss.recorded import run_recorded
    from conveyor.config import load_config

    (run_recorded if recorded else run_gnss)(load_config(config), run=run or _new_run())


def regressor(*, config: Path, name: str, run: str | None = None) -> None:
    """Weigh views; any number of regressors, anywhere.

    Parameters
    ----------
    config
        The line's TOML file.
    name
        This worker's name, unique on the line.
    run
        Id of this run, for the counters only; default: the time of its start.
    """
    from conveyor.config import load_config
    from conveyor.heap import keep_buffers
    from regressor.serve.node import run_regressor

    line = load_config(config)
    os.nice(line.regressor.nice)
    keep_buffers()
    run_regressor(line, name=name, run=run or _new_run())


def aggregator(*, config: Path, run: str | None = None, fingerprint: str = "", new_run: bool = False) -> None:
    """Count every tuber once and keep the line's ledger.

    Parameters
    ----------
    config
        The line's TOML file.
    run
        Id of this run; default: the time of its start. An unfinished run of the ledger is gone on with.
    fingerprint
        Of the recording that is replayed: the same one is not counted twice into one ledger.
    new_run
        Count a recording again that the ledger already holds, as a run of its own.
    """
    from aggregator.node import run_aggregator
    from conveyor.config import load_config
    from conveyor.errors import ConfigError

    line = load_config(config)
    if not line.cameras:
        raise ConfigError(f"config {config} names no camera: nothing would be counted; add [cameras.<name>]")
    run_aggregator(line, run=run or _new_run(), fingerprint="" if new_run else fingerprint)


def _new_run() -> str:
    """A run id that says when it began."""
    from datetime import UTC, datetime

    return datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
