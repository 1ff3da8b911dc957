"""The camera's log survives crashes, torn writes and an aggregator that is away; it never skips or repeats a number."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import threading
from collections import deque
from pathlib import Path

import pytest

from conveyor.errors import PERMANENT, LedgerError, StorageError
from conveyor.messages import Mark, Track
from segmenter.log_store import LogStore
from segmenter.log_writer import LogWriter
from segmenter.state_lock import only_here
from segmenter.tracklog import UNDER_WAY_AT_MOST, TrackLog
from tests.conftest import wait_until

ROOT = Path(__file__).resolve().parents[2]


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
    path = tmp_path / "front.db"
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


@pytest.mark.parametrize("step", ["append: begin", "append: commit", "append: done"])
def test_a_process_that_dies_while_it_appends_leaves_all_of_a_batch_or_nothing(tmp_path: Path, step: str) -> None:
    path = tmp_path / "front.db"

    def die(name: str) -> None:
        if name == step:
            raise RuntimeError(name)

    log = TrackLog(path, camera="front", run="r1")
    log.__enter__()
    log.append([track(1)])
    assert log.store is not None
    log.store.step = die
    with pytest.raises(RuntimeError, match=step):
        log.append([track(2), mark(0.5)])
    with TrackLog(path, camera="front", run="r1") as log:
        assert log.newest == (3 if step == "append: done" else 1)
        assert log.uncommitted == log.newest


def test_a_killed_process_loses_nothing_that_it_could_have_sent(tmp_path: Path) -> None:
    """SIGKILL while entries are written as fast as the disk takes them: what `append` returned for is there."""
    code = (
        "import sys\nfrom pathlib import Path\nfrom segmenter.tracklog import TrackLog\n"
        "from tests.segmenter.test_segmenter_tracklog import track\n"
        "with TrackLog(Path(sys.argv[1]), camera='front', run='r1') as log:\n"
        "    for n in range(1, 100_000):\n        log.append([track(n)])\n        print(n, flush=True)\n"
    )
    path = tmp_path / "front.db"
    with subprocess.Popen([sys.executable, "-c", code, path], cwd=ROOT, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        said = [int(child.stdout.readline()) for _ in range(30)]
        child.kill()
        said += [int(line) for line in child.stdout.read().splitlines()]
    with TrackLog(path, camera="front", run="r1") as log:
        assert log.newest in (said[-1], said[-1] + 1)
        assert [entry.n for entry in log.due(0.0)] == list(range(1, log.newest + 1))


def test_damage_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "front.db"
    with TrackLog(path, camera="front", run="r1") as log:
        log.append([track(1), track(2)])
    data = bytearray(path.read_bytes())
    at = data.index(b"r1/front/0-2")
    data[at] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(LedgerError, match=r"front\.db is damaged: entry 2 fails its checksum"):
        TrackLog(path, camera="front", run="r1").__enter__()
    with sqlite3.connect(path) as db:
        db.execute("DELETE FROM entry WHERE n = 2")
    db.close()
    with pytest.raises(LedgerError, match="of the entries 1 to 2 it holds 1"):
        TrackLog(path, camera="front", run="r1").__enter__()
    path.write_bytes(b"no log at all" * 100)
    with pytest.raises(LedgerError, match="not a database"):
        TrackLog(path, camera="front", run="r1").__enter__()


def test_a_full_disk_is_said_and_keeps_what_was_stored(tmp_path: Path) -> None:
    path = tmp_path / "front.db"
    with TrackLog(path, camera="front", run="r1") as log:
        log.append([track(1)])
        assert log.store is not None
        (pages,) = log.store._db.execute("PRAGMA page_count").fetchone()
        log.store._db.execute(f"PRAGMA max_page_count = {pages}")
        with pytest.raises(LedgerError, match=r"front\.db.*full.*free some space"):
            log.append([track(n) for n in range(2, 200)])
        assert (log.newest, log.uncommitted) == (1, 1)
    with TrackLog(path, camera="front", run="r1") as log:
        assert [entry.n for entry in log.due(0.0)] == [1]


def test_a_log_of_another_run_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "front.db"
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


def test_what_waits_when_another_log_was_committed_is_numbered_on(tmp_path: Path) -> None:
    """A log that was lost had got as far as 40: two tracks that waited in its successor were forgotten in silence."""
    path = tmp_path / "front.db"
    with TrackLog(path, camera="front", run="r1") as log:
        log.append([track(1), track(2), mark(0.5)])
        assert [entry.n for entry in log.due(0.0)] == [1, 2, 3]
        log.commit(40)
        assert (log.committed, log.newest, log.uncommitted) == (40, 43, 3)
        assert [(entry.n, entry.track or entry.mark) for entry in log.due(0.1)] == [
            (41, track(1)),
            (42, track(2)),
            (43, mark(0.5)),
        ]
    with TrackLog(path, camera="front", run="r1") as log:
        assert (log.committed, log.newest, log.uncommitted, log.last_mark) == (40, 43, 3, mark(0.5))
        log.commit(43)
        assert log.uncommitted == 0


@pytest.mark.parametrize("step", ["commit: begin", "commit: commit", "commit: done"])
def test_a_process_that_dies_while_it_numbers_on_loses_nothing(tmp_path: Path, step: str) -> None:
    """What waits was forgotten in one transaction and written again in the next: killed between them, it was lost."""

    def die(name: str) -> None:
        if name == step:
            raise RuntimeError(name)

    log = TrackLog(tmp_path / "front.db", camera="front", run="r1").__enter__()
    log.append([mark(0.4), mark(0.5), track(1), track(2)])
    log.commit(1)
    assert isinstance(log.store, LogStore)
    log.store.step = die
    with pytest.raises(RuntimeError, match=step):
        log.commit(40)
    with TrackLog(tmp_path / "front.db", camera="front", run="r1") as log:
        log.commit(40)
        assert [(entry.n, entry.track or entry.mark) for entry in log.due(0.1)] == [
            (41, mark(0.5)),
            (42, track(1)),
            (43, track(2)),
        ]
        assert (log.committed, log.newest, log.last_mark) == (40, 43, mark(0.5))
        assert log.since_mark == [track(1), track(2)]
    with TrackLog(tmp_path / "front.db", camera="front", run="r1") as log:
        assert log._mark_before is not None
        assert (log._mark_before.mark, log.last_mark, log.since_mark) == (mark(0.4), mark(0.5), [track(1), track(2)])


def test_a_thread_that_writes_numbers_on_in_order(tmp_path: Path) -> None:
    """All of it in one go: entries, those that another log makes move, and entries and commits after them."""
    disk, begun = threading.Event(), list[str]()

    def busy(step: str) -> None:
        begun.append(step)
        assert disk.wait(30)

    with TrackLog(tmp_path / "front.db", camera="front", run="r1", behind=True) as log:
        assert isinstance(log.store, LogWriter)
        log.store._store.step = busy
        log.append([track(1)])
        wait_until(lambda: begun, what="the first write")
        log.append([track(2), mark(0.5)])
        log.commit(40)
        assert log.due(0.0) == []
        log.append([track(3)])
        log.commit(41)
        disk.set()
        sent: list[int] = []
        wait_until(lambda: sent.extend(e.n for e in log.due(0.0)) or len(sent) == 3, what="three entries to send")
        assert sent == [42, 43, 44]
    with TrackLog(tmp_path / "front.db", camera="front", run="r1") as log:
        assert (log.committed, log.newest, log.uncommitted, log.last_mark) == (41, 44, 3, mark(0.5))
        assert [entry.track or entry.mark for entry in log.due(0.0)] == [track(2), mark(0.5), track(3)]


def test_a_slow_aggregator_is_not_sent_a_long_log_again_and_again() -> None:
    """Under overload it got 6000 entries from each of six cameras every few seconds, and confirmed nothing any more."""
    with TrackLog(None, camera="front", run="r1") as log:
        log.append([track(n) for n in range(1, 6001)])
        held, sent, now_s = deque[int](), 0, 0.0
        while log.uncommitted and now_s < 300:
            due = [entry.n for entry in log.due(now_s)]
            assert all(n <= log.committed + UNDER_WAY_AT_MOST for n in due)
            held.extend(due)
            sent += len(due)
            if round(now_s * 10) % 30 == 29:  # it takes 120 entries a second and confirms them every 3 s
                taken = [held.popleft() for _ in range(min(360, len(held)))]
                log.commit(max(taken, default=0))
            now_s += 0.1
        assert log.uncommitted == 0, f"stuck at {log.committed} after {sent} entries"
        assert sent <= 1.3 * 6000


def test_an_aggregator_that_confirms_nothing_is_sent_ever_less() -> None:
    """512 entries of each of six cameras every 8 s were more than one on a starved host could read as repeats."""
    with TrackLog(None, camera="front", run="r1") as log:
        log.append([track(n) for n in range(1, 2001)])
        sent = [len(log.due(0.1 * turn)) for turn in range(3000)]
        assert sum(sent[:200]) > UNDER_WAY_AT_MOST
        assert sum(sent[1500:]) <= 16 * (150 / 8 + 1)
        log.commit(16)
        assert len(log.due(300.1)) == 32 - 16 + 16, "it is there again: twice as much from now on"


def test_numbers_go_on_after_what_the_aggregator_already_holds() -> None:
    with TrackLog(None, camera="front", run="r1") as log:
        log.commit(7)
        log.append([track(8)])
        assert [entry.n for entry in log.due(0.0)] == [8]


def test_the_file_stays_small_when_little_of_it_is_needed(tmp_path: Path) -> None:
    path = tmp_path / "front.db"
    with TrackLog(path, camera="front", run="r1") as log:
        for n in range(1, 200):
            log.append([mark(float(n)) if n % 50 == 45 else track(n)])
            log.commit(n - 1)
    assert path.stat().st_size < 60_000
    with TrackLog(path, camera="front", run="r1") as log:
        assert (log.newest, log.committed, log.uncommitted) == (199, 198, 1)
        assert log.last_mark == mark(195.0)
        assert [t.track_id for t in log.since_mark] == [t.track_id for t in map(track, range(196, 200))]


def test_a_log_that_is_never_committed_has_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_slow_disk_holds_up_no_frame_and_nothing_is_sent_that_is_not_on_it(tmp_path: Path) -> None:
    """What comes while the disk is busy goes there in one transaction."""
    disk, writes = threading.Event(), list[str]()

    def busy(step: str) -> None:
        writes.append(step)
        assert disk.wait(30)

    store = LogStore(tmp_path / "front.db", camera="front", run="r1")
    with TrackLog(tmp_path / "front.db", camera="front", run="r1", behind=True) as log:
        assert isinstance(log.store, LogWriter)
        log.store._store.step = busy
        log.append([track(1)])
        wait_until(lambda: writes, what="the first write")
        log.append([track(2)])
        log.append([mark(0.5)])
        assert log.newest == 3
        assert log.due(0.0) == []
        disk.set()
        sent: list[int] = []
        wait_until(lambda: sent.extend(e.n for e in log.due(0.0)) or len(sent) == 3, what="three entries to send")
        assert sent == [1, 2, 3]
        assert writes.count("append: commit") == 2
        log.commit(2)
        log.append([mark(0.6, final=True)])
    with store:
        stored = store.load()
    assert (stored.newest, stored.committed, [e.n for e in stored.entries if e.n > 2]) == (4, 2, [3, 4])


def test_what_the_writing_thread_cannot_write_is_an_error_of_the_next_call(tmp_path: Path) -> None:
    def full(step: str) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    log = TrackLog(tmp_path / "front.db", camera="front", run="r1", behind=True).__enter__()
    writer = log.store
    assert isinstance(writer, LogWriter)
    writer._store.step = full
    log.append([track(1)])
    wait_until(lambda: writer._error is not None, what="the write to fail")
    assert log.due(0.0) == []
    with pytest.raises(StorageError, match="disk is full"):
        log.append([track(2)])
    with pytest.raises(StorageError, match="disk is full"):
        log.__exit__(None, None, None)


def test_one_process_at_a_time_keeps_a_cameras_logs(tmp_path: Path) -> None:
    """Two lines of one name and one folder numbered their entries into one log, and were told to move it away."""
    code = (
        "import sys\nfrom pathlib import Path\nfrom segmenter.state_lock import only_here\n"
        "with only_here(Path(sys.argv[1]), 'field.front'):\n    print('there', flush=True)\n    sys.stdin.read()\n"
    )
    told = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", code, tmp_path], cwd=ROOT, **told) as child:  # type: ignore[call-overload]
        assert child.stdout.readline() == "there\n"
        with pytest.raises(StorageError, match=r"field\.front\.\* cannot be kept: another process keeps them"):
            only_here(tmp_path, "field.front").__enter__()
        with only_here(tmp_path, "field.rear"), only_here(None, "field.front"):
            pass
        child.kill()
    with only_here(tmp_path, "field.front"):
        pass


def test_a_folder_of_logs_that_no_other_try_would_make_ends_for_good(tmp_path: Path) -> None:
    """A segmenter tried again every 30 s forever, with exit code 75, and asked for write access to a file."""
    file = tmp_path / "state"
    file.touch()
    for folder, why in ((file, f"a file is there: {file}"), (file / "below", "Not a directory")):
        with pytest.raises(
            LedgerError, match=rf"folder {folder} .*segmenter\.state_dir.* cannot be used: {why}"
        ) as told:
            only_here(folder, "field.front").__enter__()
        assert told.value.exit_code == PERMANENT
