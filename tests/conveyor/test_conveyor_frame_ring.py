"""Frames in shared memory: what is read is what was written, or nothing."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from conveyor.frame_ring import PAGE, SLOTS, RingReader, RingWriter, ring_path
from conveyor.messages import FrameSlot
from tuberline.direct_folder import LOCK, DirectFolder, sweep


def test_what_is_read_is_what_was_written_and_what_was_written_over_is_told(tmp_path: Path) -> None:
    writer, reader = RingWriter(tmp_path / "f.ring"), RingReader(tmp_path / "f.ring")
    rng = np.random.default_rng(4)
    frames = [rng.bytes(int(size)) for size in rng.integers(1, 20_000, 3 * SLOTS)]
    writer.put(bytes(20_000))
    told = [writer.put(frame) for frame in frames]
    newest = len(frames) - SLOTS
    assert [reader.take(where) for where in told[newest:]] == frames[newest:]
    assert [reader.take(where) for where in told[:newest]] == [None] * newest
    writer.close()
    reader.close()
    assert list(tmp_path.iterdir()) == []


def test_a_larger_frame_or_a_camera_that_starts_again_gets_a_new_ring(tmp_path: Path) -> None:
    path = tmp_path / "f.ring"
    first, reader = RingWriter(path), RingReader(path)
    small = first.put(b"small")
    assert reader.take(small) == b"small"
    large = first.put(bytes(3 * PAGE))
    assert large.ring != small.ring
    assert (reader.take(large), reader.take(small)) == (bytes(3 * PAGE), None)
    again = RingWriter(path).put(b"again")  # the other one was killed: its file is there
    assert (reader.take(again), reader.take(large)) == (b"again", None)


def test_a_slot_that_is_being_written_or_was_forged_gives_nothing(tmp_path: Path) -> None:
    path = tmp_path / "f.ring"
    writer, reader = RingWriter(path), RingReader(path)
    where = writer.put(b"frame")
    assert reader.take(where) == b"frame"
    with path.open("r+b") as file:
        file.seek(PAGE)
        file.write((where.generation - 1).to_bytes(8, "little"))
    assert reader.take(where) is None
    for forged in (
        FrameSlot(where.ring, SLOTS, where.generation, where.size),
        FrameSlot(where.ring, where.slot, where.generation, 1 << 20),
        FrameSlot(where.ring + 1, where.slot, where.generation, where.size),
    ):
        assert reader.take(forged) is None


def test_a_ring_that_cannot_be_is_an_error_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        RingWriter(tmp_path / "none" / "f.ring").put(b"frame")
    with pytest.raises(OSError, match="No such file"):
        RingReader(tmp_path / "f.ring").take(FrameSlot(1, 0, 2, 5))
    for size in (1, PAGE, 2 * PAGE):  # one that was cut short, too
        (tmp_path / "f.ring").write_bytes(bytes(size))
        with pytest.raises(OSError, match="no ring of frames"):
            RingReader(tmp_path / "f.ring").take(FrameSlot(1, 0, 2, 5))
    (tmp_path / "f.ring").unlink()
    (tmp_path / "f.ring").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError):
        RingReader(tmp_path / "f.ring").take(FrameSlot(1, 0, 2, 5))


def test_frames_lie_in_memory_only_where_the_socket_does() -> None:
    assert ring_path("unixsock-stream//dev/shm/x/front.sock") == Path("/dev/shm/x/front.ring")
    assert ring_path("unixsock-stream//run/tuberline/front.sock") is None
    assert ring_path("tcp/127.0.0.1:7001") is None


def test_a_supervisors_folder_is_taken_away_when_it_is_dead_and_not_before(tmp_path: Path) -> None:
    mine = DirectFolder(memory=tmp_path)
    dead, new = tmp_path / "tuberline-dead", tmp_path / "tuberline-new"
    dead.mkdir()
    (dead / LOCK).touch()
    (dead / "front.ring").write_bytes(bytes(10))
    new.mkdir()  # it has no lock yet
    code = "import fcntl, sys; f = open(sys.argv[1], 'w'); fcntl.flock(f, fcntl.LOCK_EX); print(flush=True); input()"
    other = tmp_path / "tuberline-other"
    other.mkdir()
    with subprocess.Popen(
        [sys.executable, "-c", code, str(other / LOCK)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        sweep(tmp_path)
        assert {path.name for path in tmp_path.iterdir()} == {mine.path.name, new.name, other.name}
        process.kill()
    os.utime(new, (0, 0))
    sweep(tmp_path)
    assert list(tmp_path.iterdir()) == [mine.path]
    mine.close()
    assert list(tmp_path.iterdir()) == []
    elsewhere = DirectFolder(memory=tmp_path / "none")
    assert elsewhere.path.parent != tmp_path
    elsewhere.close()


def test_the_lock_is_held_by_the_supervisor_alone(tmp_path: Path) -> None:
    """A child that outlives it must not keep the folder."""
    folder = DirectFolder(memory=tmp_path)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    code = "print(flush=True); input()"
    with subprocess.Popen([sys.executable, "-c", code], close_fds=False, **pipes) as child:
        assert child.stdout is not None
        child.stdout.readline()
        os.close(folder._lock)
        with (folder.path / LOCK).open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        child.kill()
