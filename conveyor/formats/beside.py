"""The files that belong to a recording beside its frames, wherever its format keeps them: truth.json, line.json, and
positions.csv of the machine."""

from __future__ import annotations

from pathlib import Path

from conveyor.formats.detect import recording_kind
from conveyor.formats.mcap.layout import ATTACHMENTS
from conveyor.formats.positions import POSITIONS_FILE


def recording_files(path: Path) -> dict[str, bytes]:
    """truth.json, line.json and positions.csv of the recording at `path`, where it has them."""
    if recording_kind(path) in ("mcap", "ros2-export"):
        from conveyor.formats.mcap.reader import mcap_attachments

        beside = positions_beside(path)
        return mcap_attachments(path) | ({POSITIONS_FILE: beside.read_bytes()} if beside.is_file() else {})
    return {name: (path / name).read_bytes() for name in ATTACHMENTS if (path / name).is_file()}


def positions_beside(mcap: Path) -> Path:
    """Where a recorder keeps the machine's positions: an attachment would be lost with a recorder that is killed."""
    return mcap.with_name(f"{mcap.stem}.{POSITIONS_FILE}")
