"""Runs Tuberline's commands for the benchmarks, as a user does."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from conveyor.errors import TuberlineError


def tuberline(*args: str | Path) -> str:
    """What the command writes.

    Raises:
        TuberlineError: it failed; with its last words.
    """
    command = [sys.executable, "-m", "tuberline", *map(str, args)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise TuberlineError(f"tuberline {args[0]} ended with {done.returncode}: {done.stderr.strip()}")
    return done.stdout


def tuberline_json(*args: str | Path) -> Any:
    """The command's JSON."""
    return json.loads(tuberline(*args, "--json"))
