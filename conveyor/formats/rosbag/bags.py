"""What is in a bag, whichever program wrote it: topics, and their messages in the order in which they were stored.

Two readers: MCAP files of any profile (ROS 2, ROS 1, Foxglove) through the MCAP library, and everything else (.bag,
.db3, a bag's folder) through rosbags. Messages are decoded one by one, so that skipping frames costs little.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol

from conveyor.errors import InputError, MessageError
from conveyor.extras import missing_package
from conveyor.formats.mcap.layout import ENCODING
from conveyor.formats.mcap.reader import open_mcap
from conveyor.formats.rosbag import foxglove
from conveyor.formats.rosbag.messages import Kind, RosMessage, from_ros, kind_of, plain_type

READABLE = ("cdr", "ros1", "json", "protobuf")


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag that has messages; `type_name` as we spell it, `kind` what it is to us."""

    name: str
    type_name: str
    kind: Kind
    messages: int


@dataclass(frozen=True, slots=True)
class Stored:
    """A message as it is stored: when, on which topic, its bytes."""

    stored_ns: int
    topic: str
    raw: bytes
    origin: Any


class BagReader(Protocol):
    """An open bag."""

    @property
    def topics(self) -> tuple[Topic, ...]:
        """All topics with messages, sorted by name."""
        ...

    def stored(self, *topics: str) -> Iterator[Stored]:
        """Messages of these topics, in the order in which they were stored."""
        ...

    def decode(self, message: Stored) -> RosMessage:
        """The value of a message.

        Raises:
            MessageError: its bytes are no such message.
        """
        ...


@contextmanager
def open_bag(path: Path) -> Iterator[BagReader]:
    """The bag at `path`, its library's errors as ours.

    Raises:
        InputError: no bag that can be read, or the package that reads it is missing.
    """
    if path.is_file() and path.suffix not in (".bag", ".db3"):
        with open_mcap(path) as reader:
            yield _McapReader(path, reader)
        return
    with ExitStack() as stack:
        with _as_ours(path):
            reader = _rosbags().AnyReader([path], default_typestore=ros2_typestore())
            bag = _RosbagReader(path, stack.enter_context(reader))
        yield bag


@contextmanager
def _as_ours(path: Path) -> Iterator[None]:
    """What the library raises on a damaged bag becomes an error of ours; found by fuzzing."""
    rosbags = _rosbags()
    own = (rosbags.AnyReaderError, *rosbags.ReaderErrors, rosbags.SerdeError)
    damaged = (*_UNDECODABLE, RuntimeError, EOFError, MemoryError, OSError, sqlite3.Error)
    try:
        yield
    except own as error:
        raise InputError(f"{path} is no ROS bag that can be read: {error}") from error
    except damaged as error:
        raise InputError(f"{path} is damaged, and cannot be read as a ROS bag: {error!r}") from error


class _RosbagReader:
    """ROS 1 bags and ROS 2 bags in SQLite files or folders."""

    def __init__(self, path: Path, bag: Any) -> None:
        self._path = path
        self._bag = bag
        counts: dict[tuple[str, str], int] = {}
        for c in bag.connections:
            counts[c.topic, c.msgtype] = counts.get((c.topic, c.msgtype), 0) + c.msgcount
        found = [Topic(name, kind, kind_of(kind), count) for (name, kind), count in counts.items() if count]
        self.topics: tuple[Topic, ...] = tuple(sorted(found, key=lambda topic: topic.name))

    def stored(self, *topics: str) -> Iterator[Stored]:
        connections = [c for c in self._bag.connections if c.topic in topics]
        messages = iter(self._bag.messages(connections) if connections else ())
        while True:
            with _as_ours(self._path):
                message = next(messages, None)
            if message is None:
                return
            connection, stored_ns, raw = message
            yield Stored(stored_ns, connection.topic, raw, connection.msgtype)

    def decode(self, message: Stored) -> RosMessage:
        try:
            return from_ros(kind_of(message.origin), self._bag.deserialize(message.raw, message.origin))
        except (*_UNDECODABLE, _rosbags().AnyReaderError) as error:
            raise MessageError(f"{message.origin} cannot be decoded: {error!r}") from error


class _McapReader:
    """MCAP files with CDR, ROS 1, JSON or protobuf messages."""

    def __init__(self, path: Path, reader: Any) -> None:
        self._reader = reader
        summary = reader.get_summary()
        if summary is None:
            raise InputError(f"{path} was not closed: its writer was killed. Repair it with `tuberline recover {path}`")
        counts = summary.statistics.channel_message_counts if summary.statistics else {}
        found: dict[str, Topic] = {}
        for number, channel in summary.channels.items():
            count = int(counts.get(number, 0))
            if count and channel.message_encoding != ENCODING:
                schema = summary.schemas.get(channel.schema_id)
                name = plain_type(schema.name) if schema else "unknown"
                kind = kind_of(name) if channel.message_encoding in READABLE else "other"
                before = found[channel.topic].messages if channel.topic in found else 0
                found[channel.topic] = Topic(channel.topic, name, kind, before + count)
        self.topics: tuple[Topic, ...] = tuple(found[name] for name in sorted(found))

    def stored(self, *topics: str) -> Iterator[Stored]:
        for schema, channel, message in self._reader.iter_messages(topics=list(topics), log_time_order=False):
            origin = (plain_type(schema.name) if schema else "unknown", channel.message_encoding)
            yield Stored(message.log_time, channel.topic, message.data, origin)

    def decode(self, message: Stored) -> RosMessage:
        type_name, encoding = message.origin
        if encoding == "json":
            return foxglove.from_json(kind_of(type_name), message.raw)
        if encoding == "protobuf":
            return foxglove.from_protobuf(kind_of(type_name), message.raw)
        return decode_ros(type_name, message.raw, ros1=encoding == "ros1")


_UNDECODABLE = (
    ValueError, KeyError, IndexError, TypeError, AttributeError, AssertionError, OverflowError, struct.error
)  # fmt: skip
"""What serialisation code raises on bytes that are none of its messages, besides its own errors."""


def decode_ros(type_name: str, raw: bytes, *, ros1: bool = False) -> RosMessage:
    """The value of a serialised ROS message of a type of `KINDS`, CDR (ROS 2) or ROS 1.

    Raises:
        InputError: the package rosbags is not installed.
        MessageError: the bytes are no such message.
    """
    store = ros1_typestore() if ros1 else ros2_typestore()
    try:
        message = store.deserialize_ros1(raw, type_name) if ros1 else store.deserialize_cdr(raw, type_name)
        return from_ros(kind_of(type_name), message)
    except (*_UNDECODABLE, _rosbags().SerdeError) as error:
        raise MessageError(f"{type_name} cannot be decoded: {error!r}") from error


@lru_cache(maxsize=1)
def ros2_typestore() -> Any:
    """The library's types of ROS 2; those of a camera are the same in all of its distributions."""
    rosbags = _rosbags()
    return rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)


@lru_cache(maxsize=1)
def ros1_typestore() -> Any:
    """The library's types of ROS 1."""
    rosbags = _rosbags()
    return rosbags.get_typestore(rosbags.Stores.ROS1_NOETIC)


def _rosbags() -> Any:
    """The optional library's names."""
    try:
        from rosbags import rosbag1, rosbag2
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(missing_package(error, "rosbags", extra="bags", what="reading ROS messages")) from error
    return SimpleNamespace(
        AnyReader=AnyReader,
        AnyReaderError=AnyReaderError,
        ReaderErrors=(rosbag1.ReaderError, rosbag2.ReaderError),
        SerdeError=SerdeError,
        Stores=Stores,
        get_typestore=get_typestore,
    )
