"""The files that belong to a recording beside its frames: truth.json and line.json, wherever its format keeps them."""

from __future__ import annotations

from pathlib import Path

from conveyor.formats.detect import recording_kind
from conveyor.formats.mcap.layout import ATTACHMENTS


def recording_files(path: Path) -> dict[str, bytes]:
    """truth.json and line.json of the recording at `path`, where it has them."""
    if recording_kind(path) in ("mcap", "ros2-export"):
        from conveyor.formats.mcap.reader import mcap_attachments

        return mcap_attachments(path)
    return {name: (path / name).read_bytes() for name in ATTACHMENTS if (path / name).is_file()}
