"""Repairing an MCAP file whose writer was killed: everything up to the cut goes into a new, closed file."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Chunk, Footer, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from conveyor import __version__
from conveyor.errors import InputError
from conveyor.files import cause, whole_output
from conveyor.formats.beside import check_new, positions_beside
from conveyor.formats.mcap.reader import DAMAGE, damage_told, holds_nothing
from conveyor.formats.mcap.writer import CHUNK_BYTES


@dataclass(frozen=True, slots=True)
class Recovered:
    """What was saved.

    Attributes:
        messages: by topic.
        lost_bytes: of the file's end (or of a damaged chunk and what follows) that no whole record could be read from,
            and of messages whose channel the file does not describe.
        whole: the file was closed properly; nothing needed repairing.
        damage: what stopped the reading, in the library's words.
    """

    messages: dict[str, int]
    lost_bytes: int
    whole: bool
    damage: str


def recover(path: Path, out: Path, *, on_bytes: Callable[[int, int], None] = lambda done, total: None) -> Recovered:
    """Copy every whole message of `path` to the new file `out`, which is made whole or not at all.

    Args:
        on_bytes: called with how much of the file is read, and its size.

    Raises:
        InputError: `path` is no MCAP file, nothing of it can be saved, `out` exists or cannot be written.
    """
    check_new(out, fix="recover to another name with --out")
    try:
        if why := holds_nothing(path):
            raise InputError(f"{path} {why}")
        with path.open("rb") as source, whole_output(out) as partial:
            with partial.open("xb") as target:
                result = _copy(source, target, size=path.stat().st_size, on_bytes=on_bytes)
                if not (result.whole or result.messages):
                    raise InputError(
                        f"{path} holds no whole message: {result.lost_bytes} bytes could not be read "
                        f"({result.damage}), and there is nothing to save"
                    )
                target.flush()
                os.fsync(target.fileno())
            if (positions := positions_beside(path)).is_file():
                shutil.copyfile(positions, positions_beside(partial))
    except _Nothing as error:
        raise InputError(f"{path}: its first record is damaged ({error}), and there is nothing to save") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {cause(error)}") from error
    return result


class _Nothing(Exception):
    """Not one record is whole."""


class _Records:
    """Records up to the damage; then `damage` says what it was and `good_bytes` where the last whole record ended."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self.good_bytes = 0
        self.damage = ""
        self.closed = False

    def __iter__(self) -> Iterator[Any]:
        records = StreamReader(self._stream, emit_chunks=True, record_size_limit=1 << 30).records
        while True:
            try:
                record = next(records)
                parts = breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk) else [record]
            except StopIteration:
                return
            except (*DAMAGE, OSError) as error:  # a disk that cannot read on is damage, too
                self.damage = damage_told(error)
                if self.good_bytes == 0:
                    raise _Nothing(self.damage) from error
                return
            self.good_bytes = self._stream.tell()
            self.closed = isinstance(record, Footer)
            yield from parts


def _copy(source: Any, target: Any, *, size: int, on_bytes: Callable[[int, int], None]) -> Recovered:
    writer = Writer(target, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, tuple[int, str]] = {}
    counts: dict[str, int] = {}
    started, unknown, unknown_bytes = False, "", 0
    records = _Records(source)
    for record in records:
        on_bytes(records.good_bytes, size)
        if isinstance(record, Header) and not started:
            writer.start(profile=record.profile, library=f"tuberline {__version__} recover")
            started = True
        elif isinstance(record, Schema) and record.id not in schemas:
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in channels:
            schema = schemas.get(record.schema_id, 0)
            number = writer.register_channel(record.topic, record.message_encoding, schema, dict(record.metadata))
            channels[record.id] = (number, record.topic)
        elif isinstance(record, Message):
            if record.channel_id not in channels:
                unknown = f"no record describes channel {record.channel_id} before its messages"
                unknown_bytes += len(record.data)
                continue
            number, topic = channels[record.channel_id]
            writer.add_message(number, record.log_time, record.data, record.publish_time, record.sequence)
            counts[topic] = counts.get(topic, 0) + 1
        elif isinstance(record, Attachment):
            writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, dict(record.metadata))
    if not started:
        writer.start(library=f"tuberline {__version__} recover")
    writer.finish()  # type: ignore[no-untyped-call]
    ended = records.closed and not records.damage
    lost_bytes = (0 if ended else size - records.good_bytes) + unknown_bytes
    return Recovered(counts, lost_bytes, ended and not unknown, records.damage or unknown)
