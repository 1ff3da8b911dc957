"""The files that belong to a recording beside its frames, wherever its format keeps them: truth.json, line.json, and
positions.csv of the machine."""

from __future__ import annotations

from pathlib import Path

from conveyor.errors import InputError
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


def is_taken(mcap: Path) -> bool:
    """There is such a recording, or positions that one written there would have for its own."""
    return mcap.exists() or positions_beside(mcap).exists()


def check_new(target: Path, *, fix: str = "choose another name") -> None:
    """Refuse to write a recording where one is, or where positions of a former one would be read as its own.

    Raises:
        InputError: `target` exists, or such positions do; names them, with how to `fix` it.
    """
    if target.exists():
        raise InputError(f"{target} exists; recordings are not overwritten, {fix}")
    if target.suffix == ".mcap" and (left := positions_beside(target)).exists():
        raise InputError(
            f"{left} is of a recording that is not there any more, and would be read with {target}: {fix}, or move "
            "it away"
        )
