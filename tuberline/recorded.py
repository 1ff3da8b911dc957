"""What a replay makes of a recording beside its frames: positions that are told again, frames that are not there."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from conveyor.errors import InputError


def lost_frames(cameras: Mapping[str, Any], *, logs: Path) -> list[str]:
    """In words, which cameras of a summary had frames that are missing or could not be read."""
    return [
        f"camera '{name}': {gaps} of {sheet['frames']['published']} frames are missing or cannot be read; what can be "
        f"said of each stands in {logs / f'camera-{name}.log'}"
        for name, sheet in cameras.items()
        if (gaps := sheet["frames"].get("gaps", 0))
    ]


def has_positions(out: Path, *, run: str) -> tuple[bool, list[str]]:
    """Whether the recording's positions can be told again; if they cannot be read that is a finding, and tubers count
    all the same.
    """
    from camera_sim.gnss.recorded import recorded_positions
    from conveyor.formats.positions import POSITIONS_FILE

    if not (out / POSITIONS_FILE).is_file():
        return False, []
    try:
        return bool(recorded_positions(out / POSITIONS_FILE, run=run)), []
    except InputError as error:
        return False, [f"the machine's positions are not replayed: {error}"]
