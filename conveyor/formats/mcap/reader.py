"""Reading a camera of our MCAP recordings, in the order in which it was written."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.stream_reader import CRCValidationError

from conveyor.errors import InputError, MessageError
from conveyor.formats.mcap.layout import (
    ATTACHMENTS,
    ENCODING,
    FORMAT_METADATA,
    FORMAT_NAME,
    FORMAT_VERSION,
    camera_of,
    topic_of,
)
from conveyor.formats.source import CameraDescription, FrameKey, Refused
from conveyor.formats.versions import check_version
from conveyor.messages import Frame
from conveyor.pose import pose_fault

DAMAGE = (
    McapError, CRCValidationError, zstandard.ZstdError, struct.error, ValueError, KeyError, MemoryError, OverflowError
)  # fmt: skip
"""What the MCAP library raises on files that are cut or damaged."""
MCAP0_MAGIC = b"\x89MCAP0\r\n"
USUAL_FPS, MOST_FPS = 30.0, 1000.0
FIRST_RECORD = struct.Struct("<BQ")
"""What each record begins with: its kind, and how many bytes follow."""
WRITTEN_WITHIN_S = 10.0
"""A recorder brings what it has to the disk every second (`McapFrameWriter`)."""


@dataclass(frozen=True, slots=True)
class McapChannel:
    """A camera's channel: its name, its number of messages, and what else was written down of the camera."""

    camera: str
    messages: int
    fps: float | None
    resting_offset_mm: float | None
    resting_sd_mm: float | None


def mcap_channels(path: Path) -> tuple[McapChannel, ...]:
    """The cameras of the file at `path` by name; empty where it holds none of ours.

    Raises:
        InputError: no MCAP file, one whose writer was killed, or one of a newer version.
    """
    with open_mcap(path) as reader:
        summary = reader.get_summary()
        stated = [record.metadata for record in reader.iter_metadata() if record.name == FORMAT_METADATA]
    for metadata in stated:
        check_version(metadata.get("version"), newest=FORMAT_VERSION, what=FORMAT_NAME, where=path)
    if summary is None:
        raise InputError(being_written(path) or f"{path} was not closed: its writer was killed. {recover_it(path)}")
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    found = []
    for number, channel in summary.channels.items():
        camera = camera_of(channel.topic)
        if camera is not None and channel.message_encoding == ENCODING:
            said = [_number(channel.metadata, key, path) for key in ("fps", "resting_offset_mm", "resting_sd_mm")]
            found.append(McapChannel(camera, int(counts.get(number, 0)), *said))
    return tuple(sorted(found, key=lambda channel: channel.camera))


def _number(metadata: dict[str, str], key: str, path: Path) -> float | None:
    text = metadata.get(key)
    try:
        return float(text) if text else None
    except ValueError as error:
        raise InputError(f"{path}: a channel's {key} is '{text}', not a number") from error


def foreign_channels(path: Path) -> bool:
    """The file has channels that are not ours."""
    with open_mcap(path) as reader:
        summary = reader.get_summary()
    return any(channel.message_encoding != ENCODING for channel in summary.channels.values())


def mcap_attachments(path: Path) -> dict[str, bytes]:
    """The recording's own files by name."""
    with open_mcap(path) as reader:
        return {a.name: bytes(a.data) for a in reader.iter_attachments() if a.name in ATTACHMENTS}


def _of_two_runs(one: bytes, other: bytes) -> bool:
    """Whether two frames were recorded in different runs; one that does not decode says nothing of that."""
    try:
        return Frame.decode(one).run != Frame.decode(other).run
    except MessageError:
        return False


class McapSource:
    """Frames of one camera by their numbers, in file order: a jump of the camera's clock does not reorder them.

    Recorders up to 0.1 went on in the same file when the line was started again. The second run's numbers, and the
    belt's travel, begin at 0 again there: `part` says which of a file's runs to read, from 1 on. Without it a second
    one is an error, for frames of two runs cannot be taken for one belt's.
    """

    def __init__(self, path: Path, camera: str, *, part: int | None = None) -> None:
        self._path = path
        self._camera = camera
        self._part = part
        channel = next((c for c in mcap_channels(path) if c.camera == camera), None)
        if channel is None or channel.messages == 0:
            raise InputError(f"{path} has no frames of camera '{camera}'")
        self._description = self._describe(channel)

    @property
    def description(self) -> CameraDescription:
        """From the first frame."""
        return self._description

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """Frames in file order; what does not decode, or has no rigid pose, is refused and the rest goes on.

        Raises:
            InputError: a chunk is damaged, or a second run begins and no `part` was chosen.
        """
        rigid = self._description.belt_from_camera
        for item in self._decoded(run, after):
            pose = item.belt_from_camera if isinstance(item, Frame) else None
            if pose is not None and (rigid is None or not np.array_equal(pose, rigid)):
                fault = pose_fault(pose)
                if fault:
                    text = f"frame {item.seq} of camera '{self._camera}' in {self._path}: {fault}"
                    yield Refused(item.seq, "bad_pose", text)
                    continue
                rigid = pose
            yield item

    def _decoded(self, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        for message in self._messages():
            if message.sequence <= after:
                continue
            try:
                # Whom it followed on the link it was recorded from says nothing of its way from here.
                yield replace(Frame.decode(message.data), run=run, after_seq=None)
            except MessageError as error:
                text = f"frame {message.sequence} of camera '{self._camera}' in {self._path}: {error}"
                yield Refused(message.sequence, "undecodable", text)

    def keys(self) -> list[FrameKey]:
        """From the messages' sequence numbers and log times."""
        return [FrameKey(message.sequence, message.log_time) for message in self._messages()]

    def _messages(self) -> Iterator[Any]:
        """The camera's messages of one run, their numbers rising: one that is late, or there twice, begins no other run
        and is left out, as a recorder does. Of what is late the number is a gap.
        """
        part, newest, first = 1, -1, None
        with open_mcap(self._path) as reader:
            for _, _, message in reader.iter_messages(topics=[topic_of(self._camera)], log_time_order=False):
                first = message if first is None else first
                if message.sequence <= newest:
                    if not _of_two_runs(message.data, first.data):
                        continue
                    part, first = part + 1, message
                    if self._part is None:
                        raise InputError(
                            f"{self._path}: after frame {newest} of camera '{self._camera}' the numbers begin at "
                            f"{message.sequence} again: the line was started a second time while this was recorded. "
                            f"Take each run out by itself: `tuberline convert {self._path} RUN-1.mcap --part 1`, then "
                            "--part 2 and so on"
                        )
                    newest = -1
                newest = message.sequence
                if self._part in (None, part):
                    yield message
        if self._part is not None and self._part > part:
            raise InputError(f"{self._path} has no part {self._part} of camera '{self._camera}': it holds {part}")

    def _describe(self, channel: McapChannel) -> CameraDescription:
        first, times = None, []
        for frame in self._decoded("described"):
            if isinstance(frame, Frame):
                first = first or frame
                times.append(frame.captured_ns)
            if len(times) >= (2 if channel.fps else 20):
                break
        if first is None:
            raise InputError(f"{self._path} has no readable frame of camera '{self._camera}'")
        return CameraDescription(
            name=self._camera,
            origin=f"MCAP {self._path}",
            intrinsics=first.intrinsics,
            depth_scale_m=first.depth_scale_m,
            belt_distance_m=first.belt_distance_m,
            belt_from_camera=first.belt_from_camera,
            fps=channel.fps if channel.fps is not None and 0 < channel.fps <= MOST_FPS else rate_of(times),
            frames=channel.messages,
            resting_offset_mm=channel.resting_offset_mm,
            resting_sd_mm=channel.resting_sd_mm,
        )


def rate_of(times_ns: list[int]) -> float:
    """Frames per second from capture times: the median step; 30 where there are fewer than two, or times that no camera
    has: numbers, or another unit.
    """
    steps = np.diff(np.asarray(times_ns, np.int64))
    steps = steps[steps > 0]
    fps = float(round(1e9 / float(np.median(steps)), 3)) if len(steps) else 0.0
    return fps if 0 < fps <= MOST_FPS else USUAL_FPS


@contextmanager
def open_mcap(path: Path) -> Iterator[Any]:
    """The library's reader of the file at `path`, its errors as ours."""
    try:
        if why := holds_nothing(path):
            raise InputError(f"{path} {why}")
        with path.open("rb") as file:
            yield SeekingReader(file, validate_crcs=True, record_size_limit=1 << 30)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    except DAMAGE as error:
        damage = f"{path} is cut or damaged ({damage_told(error)}). {recover_it(path)}"
        raise InputError(being_written(path) or damage) from error


def holds_nothing(path: Path) -> str:
    """Why not one record can be read of a file: it is none of MCAP, or cut in its first one; empty where one can.

    Raises:
        OSError: it cannot be read at all.
    """
    with path.open("rb") as file:
        magic, size = file.read(len(MCAP0_MAGIC)), path.stat().st_size
        if magic != MCAP0_MAGIC:
            return "is no MCAP file: it " + ("does not begin with MCAP's magic bytes" if size else "is empty")
        head = file.read(FIRST_RECORD.size)
    if len(head) == FIRST_RECORD.size and len(magic + head) + FIRST_RECORD.unpack(head)[1] <= size:
        return ""
    return f"is an MCAP file of {size} bytes that is cut within its first record: there is nothing in it to save"


def being_written(path: Path) -> str:
    """That a file without an end is still being recorded, where it grew a moment ago; else empty."""
    ago_s = time.time() - path.stat().st_mtime
    with path.open("rb") as file:
        begun = file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
        file.seek(max(0, path.stat().st_size - len(MCAP0_MAGIC)))
        ended = begun and file.tell() > 0 and file.read() == MCAP0_MAGIC
    if not begun or ended or not 0 <= ago_s < WRITTEN_WITHIN_S:
        return ""
    return (
        f"{path} is being written: {path.stat().st_size / 1e6:.1f} MB, the last of them {ago_s:.0f} s ago, and no end "
        f"yet. Look again when its recorder has stopped; where it was killed, {recover_it(path)}"
    )


def damage_told(error: Exception) -> str:
    """What a library said of a damaged file, with the fault's name, which is often all it says."""
    return ": ".join(filter(None, (type(error).__name__, str(error))))


def recover_it(path: Path) -> str:
    """What saves a file without an end."""
    return f"`tuberline recover {path}` saves what is whole"
