"""An MCAP file that Foxglove opens: its own schemas, in order of time, compressed."""

from __future__ import annotations

import heapq
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from mcap.writer import CompressionType, Writer

from conveyor import __version__
from viewer.foxglove.pen import encoded, schema_of

CHUNK_BYTES = 1 << 20
FORMAT_METADATA = "tuberline.foxglove"


class McapOutlet:
    """Messages of any topics, written in order of their times: what lies ahead waits until the file has come so far.

    Raises:
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: IO[bytes] | None = None
        self._writer: Any = None
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._kinds: dict[str, str] = {}
        self._ahead: list[tuple[int, int, str, bytes]] = []
        self._taken = 0
        self.messages = 0

    def __enter__(self) -> Self:
        self._file = self._path.open("xb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"tuberline {__version__}")
        self._writer.add_metadata(FORMAT_METADATA, {"version": "1"})
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.come_to(None)
                self._writer.finish()
        finally:
            if self._file is not None:
                self._file.close()

    def wants(self, topic: str, kind: str) -> bool:
        """A file takes everything."""
        if topic not in self._channels:
            encoding, name, schema_encoding, data = schema_of(kind)
            if kind not in self._schemas:
                self._schemas[kind] = self._writer.register_schema(name, schema_encoding, data)
            self._channels[topic] = self._writer.register_channel(topic, encoding, self._schemas[kind])
            self._kinds[topic] = kind
        return True

    def put(self, topic: str, message: Any, captured_ns: int) -> None:
        """Write a message when its time has come."""
        self._taken += 1
        heapq.heappush(self._ahead, (captured_ns, self._taken, topic, encoded(self._kinds[topic], message)))

    def come_to(self, captured_ns: int | None) -> None:
        """Write what lies before this time; None: everything."""
        while self._ahead and (captured_ns is None or self._ahead[0][0] < captured_ns):
            at_ns, _, topic, data = heapq.heappop(self._ahead)
            self._writer.add_message(
                channel_id=self._channels[topic], log_time=at_ns, publish_time=at_ns, sequence=self.messages, data=data
            )
            self.messages += 1
