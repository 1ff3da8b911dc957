"""Recording a line: frames of all its cameras to one MCAP file and the machine's positions beside it, by a process of
its own that none waits for."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from pathlib import Path

from conveyor import topics
from conveyor.config import BeltConfig, LineConfig
from conveyor.delivery import KeptSubscriber, LatestSubscriber, ReliableSubscriber
from conveyor.errors import StorageError
from conveyor.files import free_name, told
from conveyor.formats.beside import is_taken, positions_beside
from conveyor.formats.mcap.writer import CHUNK_BYTES, SYNC_EVERY_S, McapFrameWriter
from conveyor.formats.positions import PositionsWriter
from conveyor.messages import CameraInfo, Frame, Position
from conveyor.node import Node

RING_FRAMES = 48
"""Newest frames kept while the disk is slow: 0.8 s of two cameras at 30 frames/s, 40 MB at 848x480."""

MOST_POSITIONS = 1024
"""Kept while the disk is slow: 100 s of a receiver with 10 positions a second."""


class _Positions:
    """The machine's positions as they come, each once."""

    def __init__(self, node: Node) -> None:
        self._heard = ReliableSubscriber(node, topics.POSITION, Position, capacity=MOST_POSITIONS, receiver="*")
        self._counters = node.counters
        self._newest: dict[tuple[str, str], tuple[int, int]] = {}
        for counter in ("positions_written", "positions_duplicate"):
            self._counters.add(counter, 0)

    def write_to(self, parts: _Parts) -> None:
        """Write what has come, without waiting for more."""
        while (at := self._heard.get(0.0)) is not None:
            if not self._is_new(at):
                self._counters.add("positions_duplicate")
                continue
            parts.open.add(at)
            self._counters.add("positions_written")

    def _is_new(self, at: Position) -> bool:
        """A replay whose process was started again tells its positions from the first on."""
        key = (at.run, at.receiver)
        before = self._newest.get(key, (-1, -1))
        if at.n <= before[0] and at.time_ns <= before[1]:
            return False
        self._newest[key] = (at.n, at.time_ns)
        return True


class _Gaps:
    """Frames of one camera that were published but never arrived here, by their numbers."""

    def __init__(self) -> None:
        self._newest: dict[tuple[str, str], int] = {}

    def note(self, frame: Frame) -> int | None:
        """How many frames are missing before this one; None where it came before (a resend)."""
        key = (frame.run, frame.camera)
        before = self._newest.get(key)
        if before is not None and frame.seq <= before:
            return None
        self._newest[key] = frame.seq
        return 0 if before is None else frame.seq - before - 1


@dataclass(frozen=True, slots=True)
class Part:
    """A file of a recording: where it is, and how many frames were written to it."""

    path: Path
    frames: int


class _OpenPart:
    """The file that is being written and the positions beside it; `runs`: each camera's frames in it are of one."""

    def __init__(self, path: Path, resting: Mapping[str, float]) -> None:
        self.path = path
        self._resting = resting
        self.runs: dict[str, str] = {}
        self._files = ExitStack()
        self._positions: PositionsWriter | None = None
        self.writer = self._files.enter_context(McapFrameWriter(path))

    def write(self, frame: Frame, *, fps: float | None) -> None:
        """Append `frame` to the file."""
        self.runs[frame.camera] = frame.run
        self.writer.add_camera(frame.camera, fps=fps, **self._resting)
        self.writer.write(frame)

    def add(self, at: Position) -> None:
        """Append a row to the positions; there is no file before the first one."""
        if self._positions is None:
            self._positions = self._files.enter_context(PositionsWriter(positions_beside(self.path)))
        self._positions.add(at)

    def close(self) -> Part:
        """End the file."""
        self._files.close()
        return Part(self.path, self.writer.messages)


class _Parts:
    """The files of one recording, one after the other: a camera that begins another run begins another part.

    Attributes:
        left: camera and run of frames that are not taken any more. Two lines that run at once under one name would
            begin a part with every frame.
    """

    def __init__(self, out: Path, resting: Mapping[str, float]) -> None:
        self._out, self._resting = out, resting
        self.left: set[tuple[str, str]] = set()
        self.done: list[Part] = []
        self.open = _OpenPart(free_name(out, is_taken), resting)

    def write(self, frame: Frame, *, fps: float | None) -> bool:
        """Append `frame`; returns whether a part was begun for it."""
        before = self.open.runs.get(frame.camera, frame.run)
        if before != frame.run:
            self.left.add((frame.camera, before))
            self.close()
            self.open = _OpenPart(free_name(self._out, is_taken), self._resting)
        self.open.write(frame, fps=fps)
        return before != frame.run

    def close(self) -> None:
        """End the part that is open."""
        self.done.append(self.open.close())


def stated_resting(belt: BeltConfig) -> dict[str, float]:
    """What a recording says of the resting level of its line, where that states one. Of a web it says nothing: each
    tuber's own sink is not in these figures.
    """
    if belt.surface == "rods" or (not belt.resting_offset_mm and belt.resting_sd_mm is None):
        return {}
    sd = {} if belt.resting_sd_mm is None else {"resting_sd_mm": belt.resting_sd_mm}
    return {"resting_offset_mm": belt.resting_offset_mm, **sd}


def run_recorder(config: LineConfig, out: Path, *, run: str, name: str) -> list[Part]:
    """Record until stopped; returns the files that were written, in their order, at least one.

    Nothing is overwritten, and a recorder goes on: where `out` exists, in a new part beside it; where a camera begins
    another run, because the line was stopped and started, in the next part. In a part each camera's numbers rise.

    Raises:
        StorageError: the disk is full, or gone.
    """
    with Node("recorder", name, config=config, run=run, announce=False) as node:
        parts = _Parts(out, stated_resting(config.belt))
        if parts.open.path != out:
            node.log.warning("%s, or its positions, are of another recording: going on in %s", out, parts.open.path)
        if config.belt.surface == "rods":
            node.log.info(
                "a recording does not say that its belt is a web: replay it with --places and the line's file"
            )
        try:
            with closing(parts):
                _record(node, parts)
        except OSError as error:
            part = parts.open.path
            with suppress(OSError):
                if part.stat().st_size < CHUNK_BYTES:  # no chunk: on a full disk every start would leave such a file
                    part.unlink()
                    positions_beside(part).unlink(missing_ok=True)
            raise StorageError(f"recording {told(error, part)}") from error
    return parts.done


def _record(node: Node, parts: _Parts) -> None:
    """Record into `parts` until `node` is stopped."""
    gaps = _Gaps()
    infos = KeptSubscriber(node, topics.CAMERA_INFO, CameraInfo, camera="*")
    frames = LatestSubscriber(node, topics.FRAME, Frame, capacity=RING_FRAMES, camera="*")
    positions = _Positions(node)
    for counter in ("frames_written", "frames_missing", "frames_duplicate", "frames_of_another_run"):
        node.counters.add(counter, 0)
    node.announce()
    while not node.stop.is_set() or len(frames):
        frame = frames.get(0.0 if node.stop.is_set() else SYNC_EVERY_S / 2)
        node.progress()
        positions.write_to(parts)
        if frame is None:
            parts.open.writer.sync()
            continue
        if (frame.camera, frame.run) in parts.left:
            node.counters.add("frames_of_another_run")
            continue
        missing = gaps.note(frame)
        if missing is None:
            node.counters.add("frames_duplicate")
            continue
        node.counters.add("frames_missing", missing)
        fps = {info.camera: info.fps for info in infos.latest().values()}
        if parts.write(frame, fps=fps.get(frame.camera)):
            node.log.info("camera %s began run %s: going on in %s", frame.camera, frame.run, parts.open.path)
        node.counters.add("frames_written")
