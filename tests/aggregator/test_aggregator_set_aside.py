"""An entry that no one can read is set aside: told, kept, acknowledged, and the log goes on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from aggregator.core.camera_log import LoggedEntry, Taken, set_aside
from aggregator.ledger.audit import audit_run
from aggregator.ledger.check import check_file
from aggregator.ledger.schema import ENTRY
from aggregator.ledger.writer import Ledger
from conveyor import wire
from conveyor.errors import MessageError
from conveyor.messages import TrackEntry
from tests.aggregator.belt_story import Story, tell
from tests.aggregator.virtual_line import Aggregator, fresh_run


def spoilt(entry: TrackEntry) -> bytes:
    """The entry as bytes, its tuber 3 km long."""
    kind, fields, _ = wire.unpack(entry.encode())
    fields["track"]["length_mm"] = 3e6
    return wire.pack(kind, fields, {})


def refused(payload: bytes) -> LoggedEntry | None:
    """What is set aside for bytes that are refused."""
    with pytest.raises(MessageError) as caught:
        TrackEntry.decode(payload)
    return set_aside(payload, caught.value)


def one_track(told: Story) -> TrackEntry:
    """A track in the middle of the first camera's log."""
    tracks = [entry for entry in told.logs["cam0"] if entry.track is not None]
    return tracks[len(tracks) // 2]


@pytest.mark.parametrize("ahead", [False, True], ids=["in its turn", "before its turn"])
def test_an_entry_out_of_range_is_lost_alone_and_told(tmp_path: Path, ahead: bool) -> None:
    told = tell(3, cameras=1, n=8).in_run(fresh_run("aside"))
    bad = one_track(told)
    payload = spoilt(bad)
    logged = refused(payload)
    assert logged is not None
    assert (logged.entry, logged.refused) == (TrackEntry("cam0", told.run, bad.n), "range")
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, told)
        for n in range(1, bad.n - (2 if ahead else 0)):
            it.receive("cam0", n)
        assert it.core.set_aside(logged) is Taken.SET_ASIDE
        assert it.core.set_aside(logged) is Taken.DUPLICATE
        for n in range(bad.n - 2, len(told.logs["cam0"]) + 1):
            if n != bad.n and (ahead or n > bad.n):
                it.receive("cam0", n)
        it.commit()
        assert it.acknowledged["cam0"] == len(told.logs["cam0"])
        assert it.core.finished
        it.start()  # from the ledger alone: it does not come back
        assert it.core.set_aside(logged) is Taken.DUPLICATE
        assert it.counts["entries_set_aside"] == 1
        assert bad.track is not None
        counted = {track for tuber in it.tubers() for track in tuber.tracks}
        everyone = {entry.track.track_id for entry in told.logs["cam0"] if entry.track is not None}
        assert counted == everyone - {bad.track.track_id}
        kept = [(found[2], found[5]) for found in ledger.view.rows(ENTRY, "WHERE kind = 'refused'")]
        assert kept == [(bad.n, payload)]
        run = ledger.run_row(told.run)
        assert run is not None
        audit = audit_run(ledger.view, run)
        assert audit.set_aside == {"cam0": 1}
        assert not audit.balanced
        wrong = {e.text: e.difference for equations in audit.equations.values() for e in equations if e.difference}
        assert wrong["entries that could not be read = none"] == 1
    assert check_file(tmp_path / "ledger.db") == []


def test_a_final_mark_that_nobody_can_read_ends_its_camera(tmp_path: Path) -> None:
    """The run waited for it forever: the next numbers never come, for it was the last one."""
    told = tell(3, cameras=2, n=8).in_run(fresh_run("aside-final"))
    kind, fields, _ = wire.unpack(told.logs["cam0"][-1].encode())
    assert fields["mark"]["final"]
    fields["mark"]["travel_m"] = 1e308
    logged = refused(wire.pack(kind, fields, {}))
    assert logged is not None
    assert logged.ends
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, told)
        for camera, log in told.logs.items():
            for n in range(1, len(log) + (camera != "cam0")):
                it.receive(camera, n)
        it.commit()
        assert not it.core.finished
        assert it.core.set_aside(logged) is Taken.SET_ASIDE
        it.commit()
        assert it.core.finished
        assert {track for tuber in it.tubers() for track in tuber.tracks} == {
            entry.track.track_id for log in told.logs.values() for entry in log if entry.track is not None
        }
        it.start()
        assert it.core.finished, "forgotten over a restart"


def test_what_has_no_number_or_is_of_another_release_is_waited_for() -> None:
    """It may be read by the right program: what the segmenter keeps must not be thrown away for it."""
    entry = one_track(tell(3, cameras=1, n=8))
    good = entry.encode()
    kind, fields, _ = wire.unpack(good)
    assert refused(good[:3] + b"\x02" + good[4:]) is None
    assert refused(good[:40]) is None
    assert refused(wire.pack(kind, {**fields, "n": 0}, {})) is None
    assert refused(wire.pack(kind, {**fields, "n": 2**62}, {})) is None
    assert refused(wire.pack(kind, {**fields, "camera": ["cam0"]}, {})) is None
    assert refused(wire.pack("Committed", {"camera": "c", "run": "r", "n": 1}, {})) is None


def test_another_run_or_camera_sets_nothing_aside(tmp_path: Path) -> None:
    told = tell(3, cameras=1, n=8).in_run(fresh_run("foreign"))
    logged = refused(spoilt(one_track(told)))
    assert logged is not None
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, told)
        assert it.core.set_aside(replace(logged, entry=replace(logged.entry, run="other"))) is Taken.OTHER_RUN
        assert it.core.set_aside(replace(logged, entry=replace(logged.entry, camera="side"))) is Taken.UNKNOWN_CAMERA
        assert it.core.waiting == 0
