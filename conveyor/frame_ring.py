"""Frames through memory that a camera and its segmenter on one host share, beside their direct link.

A frame of 1.8 MB through a socket is cut into pieces of 64 kB and copied by the kernel twice. Here the camera writes it
into a file in memory (`/dev/shm`), and the link carries a `FrameSlot`: where it lies. The segmenter copies it out at
once. No one waits for anyone: a slot that was written again before it was read is found by its generation, which is odd
while the camera writes, and counts as overwritten, as in any inbox. The file's space is reserved when it is made, so
that a full memory file system costs the ring and not the camera: frames then pass the link themselves.

A ring is never made smaller or used again by another process: who starts again makes a new file with a new id.
"""

from __future__ import annotations

import mmap
import os
import secrets
import struct
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import zenoh

from conveyor import topics
from conveyor.delivery.endpoint import Endpoint
from conveyor.delivery.inbox import Inbox
from conveyor.delivery.latest import LatestPublisher
from conveyor.delivery.refusals import Refusals
from conveyor.errors import MessageError
from conveyor.messages import Frame, FrameSlot

IN_MEMORY = Path("/dev/shm")
SLOTS = 8
"""So many frames may lie between the camera and a segmenter that is held up for a moment."""
MOST_SLOTS = 32
PAGE = 4096
TRY_AGAIN_S = 30.0
_FILE = struct.Struct("<8sQQQ")
"""Magic, the ring's id, slots, bytes of a slot with its head."""
_SLOT = struct.Struct("<QQ")
"""Generation, bytes of the frame."""
_MAGIC = b"TBLRING1"
_UNIX = "unixsock-stream/"


def ring_path(endpoint: str) -> Path | None:
    """Where the frames of a direct link lie; None where its socket is in no folder of a memory file system."""
    path = Path(endpoint.removeprefix(_UNIX))
    return path.with_suffix(".ring") if endpoint.startswith(_UNIX) and IN_MEMORY in path.parents else None


class RingWriter:
    """The camera's side: the newest `slots` frames, as bytes."""

    def __init__(self, path: Path, *, slots: int = SLOTS) -> None:
        self._path = path
        self._slots = slots
        self._map: mmap.mmap | None = None
        self._id = self._stride = self._written = 0

    def put(self, data: bytes) -> FrameSlot:
        """Write a frame over the oldest one.

        Raises:
            OSError: a ring that holds it cannot be made.
        """
        if self._map is None or _SLOT.size + len(data) > self._stride:
            self._make(len(data))
        assert self._map is not None
        slot, generation = self._written % self._slots, 2 * self._written + 2
        self._written += 1
        at = PAGE + slot * self._stride
        _SLOT.pack_into(self._map, at, generation - 1, 0)
        self._map[at + _SLOT.size : at + _SLOT.size + len(data)] = data
        _SLOT.pack_into(self._map, at, generation, len(data))
        return FrameSlot(ring=self._id, slot=slot, generation=generation, size=len(data))

    def close(self) -> None:
        """Take the file away; who has it open keeps what is in it."""
        if self._map is not None:
            self._map.close()
            self._map = None
            with suppress(OSError):
                self._path.unlink()

    def _make(self, size: int) -> None:
        """A new file for frames of `size` bytes, in the place of the old one."""
        self.close()
        stride = -(-(_SLOT.size + size + size // 8) // PAGE) * PAGE
        total, made = PAGE + self._slots * stride, self._path.with_suffix(f".{os.getpid()}.new")
        file = os.open(made, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        try:
            os.posix_fallocate(file, 0, total)
            self._map = mmap.mmap(file, total)
            self._id, self._stride, self._written = secrets.randbits(48), stride, 0
            _FILE.pack_into(self._map, 0, _MAGIC, self._id, self._slots, stride)
            made.replace(self._path)
        except OSError:
            with suppress(OSError):
                made.unlink()
            raise
        finally:
            os.close(file)


class RingReader:
    """The segmenter's side."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._map: mmap.mmap | None = None
        self._id = self._slots = self._stride = 0

    def take(self, where: FrameSlot) -> bytes | None:
        """A copy of the frame; None where the camera has written over it, or has a new ring by now.

        Raises:
            OSError: the ring cannot be read.
        """
        if self._map is None or self._id != where.ring:
            self._open()
        if self._map is None or self._id != where.ring or where.slot >= self._slots:
            return None
        at = PAGE + where.slot * self._stride
        written = (where.generation, where.size)
        if where.size > self._stride - _SLOT.size or _SLOT.unpack_from(self._map, at) != written:
            return None
        data = self._map[at + _SLOT.size : at + _SLOT.size + where.size]
        return data if _SLOT.unpack_from(self._map, at) == written else None

    def close(self) -> None:
        """Let go of the ring."""
        if self._map is not None:
            self._map.close()
            self._map = None

    def _open(self) -> None:
        self.close()
        file = os.open(self._path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            found = mmap.mmap(file, 0, access=mmap.ACCESS_READ)
        except ValueError as error:
            raise OSError(str(error)) from error
        finally:
            os.close(file)
        magic, ring, slots, stride = _FILE.unpack_from(found) if len(found) > PAGE else (b"", 0, 0, 0)
        if magic != _MAGIC or stride < _SLOT.size or PAGE + slots * stride != len(found):
            found.close()
            raise OSError(f"{self._path} is no ring of frames")
        self._map, self._id, self._slots, self._stride = found, ring, slots, stride


class RingOutlet:
    """Sends frames by a ring where the segmenter takes them from it."""

    def __init__(self, link: Endpoint, path: Path, *, camera: str, slots: int = SLOTS) -> None:
        self._writer = RingWriter(path, slots=slots)
        self._where = LatestPublisher(link, topics.FRAME_SLOT, camera=camera)
        self._log = link.log
        self._not_before_s = 0.0
        self._told = False

    @property
    def has_reader(self) -> bool:
        """The segmenter takes frames from a ring."""
        return self._where.has_listener

    def put(self, data: bytes) -> bool:
        """Send an encoded frame; False where it has to go another way."""
        if time.monotonic() < self._not_before_s or not self.has_reader:
            return False
        try:
            self._where.put(self._writer.put(data))
        except OSError as error:
            self._not_before_s = time.monotonic() + TRY_AGAIN_S
            if not self._told:
                self._told = True
                self._log.warning("no shared memory for frames (%s): they pass the socket", error.strerror or error)
            return False
        return True

    def close(self) -> None:
        """Take the ring away."""
        self._writer.close()


class RingInlet:
    """Hands frames from a ring to the inbox that also takes those from the link.

    A ring that cannot be read is told once and left: the camera then sends the frames themselves.
    """

    def __init__(self, link: Endpoint, path: Path, inbox: Inbox[Frame], *, camera: str) -> None:
        self._reader = RingReader(path)
        self._inbox = inbox
        self._key = topics.FRAME.key(link.line, camera=camera)
        self._log = link.log
        self._refusals = Refusals(topics.FRAME_SLOT, name="frame_slot", counters=link.counters, log=link.log)
        self._left = False
        self._subscriber: Any = link.session.declare_subscriber(
            topics.FRAME_SLOT.key(link.line, camera=camera), zenoh.handlers.Callback(self._take, indirect=False)
        )

    def _take(self, sample: zenoh.Sample) -> None:
        """Zenoh's callback, on its receiving thread."""
        try:
            data = self._reader.take(FrameSlot.decode(sample.payload.to_bytes()))
        except MessageError as error:
            self._refusals.refuse(str(sample.key_expr), error)
            return
        except OSError as error:
            if not self._left:
                self._left = True
                self._log.warning("frames cannot be read from shared memory (%s): the socket takes them", error)
                threading.Thread(target=self._subscriber.undeclare, daemon=True).start()
            data = None
        if data is None:
            self._inbox.missed()
        else:
            self._inbox.push_data(self._key, data)
