"""Runs Tuberline's commands for the benchmarks, as a user does."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from conveyor.errors import TuberlineError


def tuberline(*args: str | Path, codes: tuple[int, ...] = (0,)) -> str:
    """What the command writes.

    Raises:
        TuberlineError: it ended with a code that is not of `codes`; with its last words.
    """
    command = [sys.executable, "-m", "tuberline", *map(str, args)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in codes:
        raise TuberlineError(f"tuberline {args[0]} ended with {done.returncode}: {done.stderr.strip()}")
    return done.stdout


def audited(run: Path) -> Any:
    """What `tuberline audit` says of a run, whether its books balance or not."""
    return json.loads(tuberline("audit", run, "--json", codes=(0, 1)))


def scored(run: Path, truth: Path) -> Any:
    """What `tuberline score` says of a run."""
    return json.loads(tuberline("score", run, "--truth", truth, "--json"))
