"""The core and the ledger around it: order, refusals, bounds, balance, runs. Every counter is driven above zero."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

import aggregator.core.camera_log
import aggregator.core.machine
from aggregator.core.balance import camera_equations
from aggregator.core.camera_log import CameraLog, Taken
from aggregator.ledger.audit import audit_run
from aggregator.ledger.export import full_lines
from aggregator.ledger.files import tubers_csv, write_whole
from aggregator.ledger.reader import read_runs, reading, the_run
from aggregator.ledger.writer import Ledger
from conveyor.errors import LedgerError
from conveyor.messages import TrackEntry
from tests.aggregator.belt_story import Story, tell
from tests.aggregator.virtual_line import Aggregator, fresh_run, undisturbed


@contextmanager
def begun(tmp_path: Path, told: Story) -> Iterator[tuple[Ledger, Aggregator]]:
    with Ledger(tmp_path / "ledger.db") as ledger:
        yield ledger, Aggregator(ledger, told)


def test_entries_apply_in_order_and_gaps_wait(tmp_path: Path) -> None:
    told = tell(1).in_run(fresh_run("order"))
    with begun(tmp_path, told) as (ledger, it):
        assert it.receive("cam0", 3) is Taken.WAITING
        assert it.receive("cam0", 3) is Taken.DUPLICATE
        assert it.core.applied()["cam0"] == 0
        assert it.core.waiting == 1
        assert it.receive("cam0", 1) is Taken.APPLIED
        assert it.core.applied()["cam0"] == 1
        assert it.receive("cam0", 2) is Taken.APPLIED
        assert it.core.applied()["cam0"] == 3
        assert it.receive("cam0", 1) is Taken.DUPLICATE
        it.commit()
        assert [row[0] for row in ledger._db.execute("SELECT n FROM entry ORDER BY n")] == [1, 2, 3]
        assert it.counts == {"entries_waited": 1, "entries_duplicate": 2, "entries_applied": 3}


def test_what_cannot_be_taken_is_counted_with_its_reason(tmp_path: Path) -> None:
    told = tell(1).in_run(fresh_run("refuse"))
    with begun(tmp_path, told) as (_ledger, it):
        entry = told.logs["cam0"][0]
        other = replace(told.logs["cam0"][1], n=1)
        assert it.core.receive(replace(entry, run="elsewhere"), now_s=0) is Taken.OTHER_RUN
        assert it.core.receive(replace(entry, camera="side"), now_s=0) is Taken.UNKNOWN_CAMERA
        assert it.core.receive(replace(entry, track=None, mark=None), now_s=0) is Taken.MALFORMED
        assert it.core.receive(replace(entry, n=0), now_s=0) is Taken.MALFORMED
        assert it.core.receive(entry, now_s=0) is Taken.APPLIED
        assert it.core.receive(other, now_s=0) is Taken.CONFLICTING
        it.commit()
        it.start()
        assert it.core.receive(other, now_s=0) is Taken.CONFLICTING
        assert it.core.receive(entry, now_s=0) is Taken.DUPLICATE
        assert it.counts == {
            "entries_refused_other_run": 1,
            "entries_refused_unknown_camera": 1,
            "entries_refused_malformed": 2,
            "entries_applied": 1,
            "entries_conflicting": 2,
            "entries_duplicate": 1,
        }


def test_entries_waiting_for_a_gap_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aggregator.core.camera_log, "WAITING_ENTRIES", 3)
    log = CameraLog()
    entries = tell(2).logs["cam0"]
    taken = [log.take(entry, lambda n: None)[0] for entry in entries[1:6]]
    assert taken == [Taken.WAITING] * 3 + [Taken.WAITING_FULL] * 2
    assert [logged.entry.n for logged in log.take(entries[0], lambda n: None)[1]] == [1, 2, 3, 4]
    assert log.take(entries[5], lambda n: None)[0] is Taken.WAITING


def test_tracks_waiting_for_a_camera_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A camera that lives but does not get on must not fill the memory."""
    monkeypatch.setattr(aggregator.core.machine, "MAX_PENDING", 4)
    told = tell(4, cameras=3, n=12).in_run(fresh_run("bound"))
    with begun(tmp_path, told) as (_ledger, it):
        it.receive("cam1", 1)
        it.receive("cam2", 1)
        for entry in told.logs["cam0"]:
            it.receive("cam0", entry.n)
        it.commit()
        assert it.counts["pending_limit_reached"] == 1
        assert it.core.pending <= 4
        assert it.tubers()


def test_a_track_told_twice_is_counted_once(tmp_path: Path) -> None:
    """A segmenter that lost its state tells an old track again under a new number."""
    told = tell(3, cameras=1, n=6).in_run(fresh_run("again"))
    log = told.logs["cam0"]
    first = next(entry for entry in log if entry.track is not None)
    final = log.pop()
    log.append(replace(first, n=final.n))
    log.append(replace(final, n=final.n + 1))
    with begun(tmp_path, told) as (ledger, it):
        it.deliver_the_rest()
        assert it.core.finished
        assert len(it.tubers()) == len(told.seen())
        assert it.counts["tracks_repeated"] == 1
        roles = dict(ledger._db.execute("SELECT role, count(*) FROM observation GROUP BY role"))
        assert roles["repeat"] == 1


def test_the_table_and_the_export_hold_every_tuber(tmp_path: Path) -> None:
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = undisturbed(ledger, tell(5))
        rows = "".join(tubers_csv(it.tubers())).splitlines()
        assert rows[0].startswith("id,place_x_m,place_y_m,weight_g,low_g,high_g,length_mm")
        assert [int(row.split(",")[0]) for row in rows[1:]] == [tuber.tuber_id for tuber in it.tubers()]
        run = ledger.run_row(it.story.run)
        assert run is not None
        exported = [json.loads(line) for line in full_lines(ledger.view, run)]
        assert [line["weight_g"] for line in exported] == [tuber.weight_g for tuber in it.tubers()]
        canonical = "\n".join(it.canonical())
        assert it.story.run not in canonical


def test_a_balance_that_holds_and_one_that_does_not(tmp_path: Path) -> None:
    with Ledger(tmp_path / "ledger.db") as ledger:
        told = tell(6)
        it = undisturbed(ledger, told)
        run = ledger.run_row(it.story.run)
        assert run is not None
        audit = audit_run(ledger.view, run)
        assert audit.balanced
        assert audit.tracks["pending"] == 0
        final = told.logs["cam0"][-1].mark
        assert final is not None
        assert all(equation.difference == 0 for equation in camera_equations(final))
        wrong = camera_equations(replace(final, frames={**final.frames, "received": final.frames["received"] - 3}))
        assert [equation.difference for equation in wrong] == [3, -3, 0, 0]
        lost = camera_equations(replace(final, views={"sent": 10, "weighed": 7, "lost_deadline": 2}))
        assert [equation.difference for equation in lost] == [0, 0, 1, 0]


def test_a_camera_that_counted_more_than_it_told_is_found_out(tmp_path: Path) -> None:
    told = tell(7, cameras=1).in_run(fresh_run("short"))
    final = told.logs["cam0"][-1]
    assert final.mark is not None
    more = {**final.mark.tracks, "opened": final.mark.tracks["opened"] + 1, "counted": final.mark.tracks["counted"] + 1}
    told.logs["cam0"][-1] = replace(final, mark=replace(final.mark, tracks=more))
    with begun(tmp_path, told) as (ledger, it):
        it.deliver_the_rest()
        run = ledger.run_row(told.run)
        assert run is not None
        audit = audit_run(ledger.view, run)
        assert not audit.balanced
        (wrong,) = [e for equations in audit.equations.values() for e in equations if e.difference]
        assert wrong.text == "tracks counted or kept by the camera = tracks in the ledger, repeats aside"
        assert wrong.difference == 1


def open_run(ledger: Ledger, run: str, **changes: object) -> None:
    given: dict = {"line": "t", "cameras": ["a"], "version": "1", "started_ns": 0, **changes}
    ledger.open_run(run, **given)


def test_a_finished_run_a_known_recording_and_other_cameras_are_refused(tmp_path: Path) -> None:
    with Ledger(tmp_path / "ledger.db") as ledger:
        open_run(ledger, "r1", fingerprint="abc")
        open_run(ledger, "r1", fingerprint="abc")
        with pytest.raises(LedgerError, match="begun with cameras a, the config has a, b"):
            open_run(ledger, "r1", cameras=["b", "a"])
        with pytest.raises(LedgerError, match=r"already holds this recording \(abc\) as run 'r1'"):
            open_run(ledger, "r2", fingerprint="abc")
        open_run(ledger, "r2")
        ledger.finish("r1", "{}\n")
        ledger.finish("r1", "another")
        with pytest.raises(LedgerError, match="already holds run 'r1', finished"):
            open_run(ledger, "r1")
        open_run(ledger, "r1", may_be_finished=True)
        assert ledger._db.execute("SELECT payload FROM summary").fetchall() == [("{}\n",)]
    with reading(tmp_path / "ledger.db") as db:
        assert [(run.run, run.finished) for run in read_runs(db)] == [("r1", True), ("r2", False)]
        with pytest.raises(LedgerError, match="holds 2 runs; choose one with --run: r1, r2"):
            the_run(db, tmp_path, None)
        with pytest.raises(LedgerError, match="holds no run 'r3'"):
            the_run(db, tmp_path, "r3")


def test_two_runs_in_one_ledger_do_not_touch_each_other(tmp_path: Path) -> None:
    with Ledger(tmp_path / "ledger.db") as ledger:
        first, second = undisturbed(ledger, tell(8)), undisturbed(ledger, tell(8))
        assert first.canonical() == second.canonical()
        assert first.story.run != second.story.run


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_whole(path, "one")
    write_whole(path, "two")
    assert path.read_text() == "two"
    assert [p.name for p in tmp_path.iterdir()] == ["summary.json"]
    with pytest.raises(LedgerError, match="cannot be written"):
        write_whole(tmp_path / "nowhere" / "x", "three")


def test_an_entry_is_the_same_bytes_whoever_encodes_it() -> None:
    """Duplicates are told from conflicts by their bytes."""
    for entry in tell(9).logs["cam0"]:
        assert TrackEntry.decode(entry.encode()).encode() == entry.encode()
