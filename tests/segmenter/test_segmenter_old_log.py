"""A log of version 0.1 is taken over, whole or torn."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import pytest
from test_segmenter_tracklog import mark, track

from conveyor.errors import LedgerError
from conveyor.messages import Committed, Mark, Track, TrackEntry
from segmenter.log_store import LogStore
from segmenter.old_log import MAGIC, read_old_log
from segmenter.tracklog import TrackLog


def old_log(path: Path, entries: list[Track | Mark], *, committed: int = 0) -> bytes:
    """A log as version 0.1 wrote it: records of length, CRC-32 and payload."""
    data = MAGIC
    for n, item in enumerate(entries, start=1):
        of = {"track": item, "mark": None} if isinstance(item, Track) else {"track": None, "mark": item}
        data += record(TrackEntry(camera="front", run="r1", n=n, **of).encode())
    if committed:
        data += record(Committed(camera="front", run="r1", n=committed).encode())
    path.write_bytes(data)
    return data


def record(payload: bytes) -> bytes:
    return struct.pack("<II", len(payload), zlib.crc32(payload)) + payload


def test_a_log_of_version_0_1_is_taken_over_once(tmp_path: Path) -> None:
    old_log(tmp_path / "front.log", [track(1), mark(0.5), track(2)], committed=1)
    for _ in range(2):
        with TrackLog(tmp_path / "front.db", camera="front", run="r1") as log:
            assert (log.newest, log.committed, log.uncommitted) == (3, 1, 2)
            assert log.last_mark == mark(0.5)
            assert [entry.n for entry in log.due(0.0)] == [2, 3]
        assert [path.name for path in tmp_path.iterdir()] == ["front.db"]


@pytest.mark.parametrize("step", ["take over: begin", "take over: commit", "take over: done"])
def test_a_takeover_that_dies_anywhere_loses_nothing(tmp_path: Path, step: str) -> None:
    def die(name: str) -> None:
        if name == step:
            raise RuntimeError(name)

    old_log(tmp_path / "front.log", [track(1), mark(0.5), track(2)], committed=1)
    store = LogStore(tmp_path / "front.db", camera="front", run="r1")
    store.step = die
    with pytest.raises(RuntimeError, match=step):
        store.__enter__()
    with TrackLog(tmp_path / "front.db", camera="front", run="r1") as log:
        assert (log.newest, log.committed, log.uncommitted) == (3, 1, 2)


def test_a_torn_last_record_of_version_0_1_is_cut_off_at_every_length(tmp_path: Path) -> None:
    path = tmp_path / "front.log"
    whole = len(old_log(path, [track(1)]))
    data = old_log(path, [track(1), track(2)])
    for size in range(whole, len(data)):
        path.write_bytes(data[:size])
        entries, newest, committed = read_old_log(path, camera="front", run="r1")
        assert ([entry.n for entry in entries], newest, committed) == ([1], 1, 0)


def test_a_flipped_bit_in_a_log_of_version_0_1_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "front.log"
    data = bytearray(old_log(path, [track(1), track(2)]))
    data[len(MAGIC) + 30] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(LedgerError, match=r"front\.log is damaged at byte 8"):
        TrackLog(tmp_path / "front.db", camera="front", run="r1").__enter__()
    assert path.exists()
