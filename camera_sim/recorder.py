"""Recording a line: frames of all its cameras to one MCAP file and the machine's positions beside it, by a process of
its own that none waits for."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from pathlib import Path

from conveyor import topics
from conveyor.config import LineConfig
from conveyor.delivery import KeptSubscriber, LatestSubscriber, ReliableSubscriber
from conveyor.errors import StorageError
from conveyor.files import told
from conveyor.formats.beside import positions_beside
from conveyor.formats.mcap.writer import CHUNK_BYTES, SYNC_EVERY_S, McapFrameWriter
from conveyor.formats.positions import PositionsWriter
from conveyor.messages import CameraInfo, Frame, Position
from conveyor.node import Node

RING_FRAMES = 48
"""Newest frames kept while the disk is slow: 0.8 s of two cameras at 30 frames/s, 40 MB at 848x480."""

MOST_POSITIONS = 1024
"""Kept while the disk is slow: 100 s of a receiver with 10 positions a second."""


class _Positions:
    """The machine's positions, as `positions.csv` of a run has them; there is no file before the first one."""

    def __init__(self, node: Node, path: Path, files: ExitStack) -> None:
        self._heard = ReliableSubscriber(node, topics.POSITION, Position, capacity=MOST_POSITIONS, receiver="*")
        self._counters, self._path, self._files = node.counters, path, files
        self._writer: PositionsWriter | None = None
        self._newest: dict[tuple[str, str], tuple[int, int]] = {}
        for counter in ("positions_written", "positions_duplicate"):
            self._counters.add(counter, 0)

    def keep(self) -> None:
        """Write what has come, without waiting for more."""
        while (at := self._heard.get(0.0)) is not None:
            if not self._is_new(at):
                self._counters.add("positions_duplicate")
                continue
            if self._writer is None:
                self._writer = self._files.enter_context(PositionsWriter(self._path))
            self._writer.add(at)
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


def next_part(out: Path) -> Path:
    """`out`, or where it holds a recording already the first free one of `<name>-2.mcap`, `<name>-3.mcap`, ..."""
    part, n = out, 1
    while part.exists():
        n += 1
        part = out.with_name(f"{out.stem}-{n}{out.suffix}")
    return part


def run_recorder(config: LineConfig, out: Path, *, run: str, name: str) -> tuple[int, Path]:
    """Record until stopped; returns how many frames were written, and where.

    Nothing is overwritten, and a recorder that is started again goes on: where `out` exists, in a new part beside it.

    Raises:
        StorageError: the disk is full, or gone.
    """
    part = next_part(out)
    try:
        return _record(config, part, run=run, name=name, began_as=out), part
    except OSError as error:
        with suppress(OSError):
            if part.stat().st_size < CHUNK_BYTES:  # not one chunk: on a full disk every start would leave such a file
                part.unlink()
        raise StorageError(f"recording {told(error, part)}") from error


def _record(config: LineConfig, part: Path, *, run: str, name: str, began_as: Path) -> int:
    """Record into `part` until stopped; returns how many frames were written."""
    gaps = _Gaps()
    with (
        Node("recorder", name, config=config, run=run) as node,
        McapFrameWriter(part) as writer,
        ExitStack() as files,
    ):
        if part != began_as:
            node.log.warning("%s holds a recording: going on in %s", began_as, part)
        infos = KeptSubscriber(node, topics.CAMERA_INFO, CameraInfo, camera="*")
        frames = LatestSubscriber(node, topics.FRAME, Frame, capacity=RING_FRAMES, camera="*")
        positions = _Positions(node, positions_beside(part), files)
        for counter in ("frames_written", "frames_missing", "frames_duplicate"):
            node.counters.add(counter, 0)
        while not node.stop.is_set() or len(frames):
            frame = frames.get(0.0 if node.stop.is_set() else SYNC_EVERY_S / 2)
            node.progress()
            positions.keep()
            if frame is None:
                writer.sync()
                continue
            missing = gaps.note(frame)
            if missing is None:
                node.counters.add("frames_duplicate")
                continue
            node.counters.add("frames_missing", missing)
            fps = {info.camera: info.fps for info in infos.latest().values()}
            writer.add_camera(frame.camera, fps=fps.get(frame.camera))
            writer.write(frame)
            node.counters.add("frames_written")
        node.log.info("%d frames in %s", writer.messages, part)
        return writer.messages
