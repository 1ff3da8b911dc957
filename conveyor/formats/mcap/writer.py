"""Writing frames to MCAP so that a killed writer loses at most the chunk it was filling."""

from __future__ import annotations

import os
import time
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from mcap.writer import CompressionType, Writer

from conveyor import __version__
from conveyor.errors import InputError
from conveyor.files import cause, fault_of
from conveyor.formats.mcap.layout import (
    ENCODING,
    FORMAT_METADATA,
    FORMAT_VERSION,
    PROFILE,
    SCHEMA_ENCODING,
    SCHEMA_NAME,
    SCHEMA_TEXT,
    topic_of,
)
from conveyor.messages import Frame

CHUNK_BYTES = 1 << 20
SYNC_EVERY_S = 1.0


class McapFrameWriter:
    """Frames of any number of cameras in one file; use it in a `with`. The file must not exist yet."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._channels: dict[str, int] = {}
        self._file: IO[bytes] | None = None
        self._writer: Any = None
        self._schema = 0
        self._synced_s = time.monotonic()
        self.messages = 0

    def __enter__(self) -> Self:
        self._file = open_new(self._path)
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile=PROFILE, library=f"tuberline {__version__}")
        self._writer.add_metadata(FORMAT_METADATA, {"version": str(FORMAT_VERSION)})
        self._schema = self._writer.register_schema(SCHEMA_NAME, SCHEMA_ENCODING, SCHEMA_TEXT)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._writer.finish()
            self.sync()
        finally:
            if self._file is not None:
                self._file.close()

    def add_camera(
        self,
        camera: str,
        *,
        fps: float | None = None,
        resting_offset_mm: float | None = None,
        resting_sd_mm: float | None = None,
    ) -> None:
        """Open the channel of a camera; done on its first frame where it was not done before."""
        if camera in self._channels:
            return
        said = {"fps": fps, "resting_offset_mm": resting_offset_mm, "resting_sd_mm": resting_sd_mm}
        metadata = {"camera": camera} | {key: repr(value) for key, value in said.items() if value is not None}
        self._channels[camera] = self._writer.register_channel(topic_of(camera), ENCODING, self._schema, metadata)

    def write(self, frame: Frame) -> None:
        """Append `frame`; full chunks reach the disk within a second."""
        self.add_camera(frame.camera)
        self._writer.add_message(
            channel_id=self._channels[frame.camera],
            log_time=frame.captured_ns,
            publish_time=frame.captured_ns,
            sequence=frame.seq,
            data=frame.encode(),
        )
        self.messages += 1
        if time.monotonic() - self._synced_s >= SYNC_EVERY_S:
            self.sync()

    def attach(self, name: str, data: bytes) -> None:
        """Add a file that belongs to the recording: JSON, or a table."""
        kind = "text/csv" if name.endswith(".csv") else "application/json"
        self._writer.add_attachment(create_time=0, log_time=0, name=name, media_type=kind, data=data)

    def sync(self) -> None:
        """Bring all full chunks to the disk."""
        self._synced_s = time.monotonic()
        if self._file is not None:
            self._file.flush()
            os.fsync(self._file.fileno())


def open_new(path: Path) -> IO[bytes]:
    """A new file at `path`, its folder made where it was missing.

    Raises:
        InputError: it exists, or cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("xb")
    except FileExistsError as error:
        raise InputError(f"{path} exists; recordings are not overwritten, choose another name") from error
    except OSError as error:
        raise fault_of(error, f"{path} cannot be written: {cause(error)}") from error
