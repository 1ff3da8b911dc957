"""The camera's log survives crashes, torn writes and an aggregator that is away; it never skips or repeats a number."""

from __future__ import annotations

from pathlib import Path

import pytest

from conveyor.errors import LedgerError
from conveyor.messages import Mark, Track
from segmenter.tracklog import MAGIC, TrackLog


def mark(travel_m: float, *, final: bool = False) -> Mark:
    return Mark(
        captured_ns=1,
        travel_m=travel_m,
        travel_estimated=False,
        complete_ns=1,
        complete_place_x_m=-travel_m,
        final=final,
        looked_at_m=travel_m,
        travelled_m=travel_m,
        frames={"published": 1, "received": 1, "processed": 1, "gaps": 0},
        views={"sent": 0, "weighed": 0, "outstanding": 0},
        tracks={"opened": 0, "counted": 0, "open": 0},
    )


def track(number: int) -> Track:
    return Track(
        track_id=f"r1/front/0-{number}",
        crossed_ns=1,
        crossed_x_m=0.0,
        y_m=0.0,
        travel_m=1.0,
        travel_estimated=False,
        frames=3,
        first_seq=0,
        last_seq=2,
        length_mm=80.0,
        width_mm=60.0,
        height_mm=50.0,
        visible_volume_ml=120.0,
        whole=True,
        views_sent=0,
        views=(),
        views_lost={},
    )


def test_a_restart_goes_on_where_it_stopped(tmp_path: Path) -> None:
    path = tmp_path / "front.log"
    with TrackLog(path, camera="front", run="r1") as log:
        log.append([track(1), mark(0.5)])
        log.append([track(2)])
        log.commit(1)
    with TrackLog(path, camera="front", run="r1") as log:
        assert (log.newest, log.committed, log.uncommitted) == (3, 1, 2)
        assert log.last_mark == mark(0.5)
        assert [entry.n for entry in log.due(0.0)] == [2, 3]
        log.append([track(3)])
        assert [entry.n for entry in log.due(0.0)] == [4]


def test_a_torn_last_record_is_cut_off_at_every_length(tmp_path: Path) -> None:
    path = tmp_path / "front.log"
    with TrackLog(path, camera="front", run="r1") as log:
        log.append([track(1)])
    whole = path.stat().st_size
    with TrackLog(path, camera="front", run="r1") as log:
        log.append([track(2)])
    data = path.read_bytes()
    for size in range(whole, len(data)):
        path.write_bytes(data[:size])
        with TrackLog(path, camera="front", run="r1") as log:
            assert (log.newest, log.cut_bytes) == (1, size - whole)
        assert path.stat().st_size == whole


def test_a_flipped_bit_in_the_middle_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "front.log"
    with TrackLog(path, camera="front", run="r1") as log:
        log.append([track(1), track(2)])
    data = bytearray(path.read_bytes())
    data[len(MAGIC) + 30] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(LedgerError, match=r"front\.log is damaged at byte 8"):
        TrackLog(path, camera="front", run="r1").__enter__()


def test_a_log_of_another_run_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "front.log"
    with TrackLog(path, camera="front", run="r1") as log:
        log.append([track(1)])
    with pytest.raises(LedgerError, match="run 'r1', not of camera 'front', run 'r2'"):
        TrackLog(path, camera="front", run="r2").__enter__()


def test_what_is_not_confirmed_is_sent_again_and_again_more_slowly() -> None:
    with TrackLog(None, camera="front", run="r1") as log:
        log.append([track(1), track(2)])
        assert [entry.n for entry in log.due(0.0)] == [1, 2]
        assert log.due(0.9) == []
        assert [entry.n for entry in log.due(1.0)] == [1, 2]
        assert log.due(2.9) == []
        assert [entry.n for entry in log.due(3.0)] == [1, 2]
        log.commit(1)
        log.resend()
        assert [entry.n for entry in log.due(3.1)] == [2]
        log.commit(2)
        assert log.due(60.0) == []


def test_numbers_go_on_after_what_the_aggregator_already_holds() -> None:
    with TrackLog(None, camera="front", run="r1") as log:
        log.commit(7)
        log.append([track(8)])
        assert [entry.n for entry in log.due(0.0)] == [8]


def test_the_file_shrinks_when_little_of_it_is_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("segmenter.tracklog.REWRITE_BYTES", 20_000)
    path = tmp_path / "front.log"
    with TrackLog(path, camera="front", run="r1") as log:
        for n in range(1, 200):
            log.append([mark(float(n)) if n % 50 == 45 else track(n)])
            log.commit(n - 1)
    assert path.stat().st_size < 40_000
    with TrackLog(path, camera="front", run="r1") as log:
        assert (log.newest, log.committed, log.uncommitted) == (199, 198, 1)
        assert log.last_mark == mark(195.0)
        assert [t.track_id for t in log.since_mark] == [t.track_id for t in map(track, range(196, 200))]


def test_a_log_that_nobody_commits_has_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("segmenter.tracklog.MAX_UNCOMMITTED", 3)
    with TrackLog(None, camera="front", run="r1") as log:
        log.append([track(1), track(2), track(3)])
        with pytest.raises(LedgerError, match="is it running"):
            log.append([track(4)])


def test_finished_means_final_and_committed() -> None:
    with TrackLog(None, camera="front", run="r1") as log:
        log.append([mark(1.0, final=True)])
        assert not log.finished
        log.commit(1)
        assert log.finished
