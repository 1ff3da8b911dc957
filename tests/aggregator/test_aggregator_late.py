"""A camera that falls silent holds no one up for longer than it may, and its late tracks are not counted twice."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aggregator.core.cameras import STARTUP_GRACE_S
from aggregator.ledger.writer import Ledger
from conveyor.messages import TrackEntry
from tests.aggregator.belt_story import Story, tell
from tests.aggregator.virtual_line import STALL_S, Aggregator, fresh_run, undisturbed


def each_tuber_once(it: Aggregator, told: Story) -> None:
    """The ledger holds every tuber that some camera saw, and none twice."""
    tubers = it.tubers()
    for true in told.seen():
        near = [t for t in tubers if np.hypot(t.place_x_m - true.x_m, t.place_y_m - true.y_m) < 0.03]
        assert len(near) == 1, (true, near)
    assert len(tubers) == len(told.seen())


def send_all(it: Aggregator, camera: str, upto: int | None = None) -> None:
    for entry in it.story.logs[camera][:upto]:
        it.receive(camera, entry.n)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("restart", [False, True])
def test_late_tracks_change_nothing_or_add_what_only_they_saw(seed: int, restart: bool, tmp_path: Path) -> None:
    told = tell(seed, cameras=2 + seed % 2, apart_m=0.1, length_m=2.0, n=16, split=0.1).in_run(fresh_run("late"))
    late = told.names[seed % len(told.names)]
    others = [name for name in told.names if name != late]
    cut = int(np.random.default_rng(seed).integers(1, len(told.logs[late]) - 1))
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, told)
        send_all(it, late, cut)
        for name in others:
            send_all(it, name)
        it.commit()
        held = len(it.tubers())
        it.now_s += STALL_S + 0.1
        for name in others:
            it.core.cameras.presence(name, alive=True, now_s=it.now_s)
        it.commit()
        assert it.core.cameras.says(it.now_s)[late] == "silent"
        before = it.tubers()
        seen_by_others = [t for t in told.seen() if any(_sees(told, name, t.y_m) for name in others)]
        assert len(before) >= max(held, len(seen_by_others))
        assert not it.core.finished
        if restart:
            it.start()
        it.deliver_the_rest()
        assert it.core.finished
        assert it.tubers()[: len(before)] == before
        each_tuber_once(it, told)
        roles = dict(ledger._db.execute("SELECT role, count(*) FROM observation GROUP BY role"))
        tracks = sum(entry.track is not None for log in told.logs.values() for entry in log)
        assert sum(roles.values()) == tracks
        assert roles.get("late_duplicate", 0) == it.counts.get("tracks_late_duplicate", 0)
        assert all(
            "late" in t.flags for t in it.tubers()[len(before) :] if t.cameras == (late,) and t.place_x_m > _low(before)
        )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("reach_mm", [0.0, 15.0, 30.0])
def test_a_live_line_waits_less_and_counts_each_tuber_once(seed: int, reach_mm: float, tmp_path: Path) -> None:
    """Waiting for no more than a part of the gate; a track of a committed tuber behind that comes as a duplicate."""
    told = tell(seed, cameras=3, apart_m=0.1, length_m=2.0, n=20, split=0.1).in_run(fresh_run("live"))
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, told, reach_mm=reach_mm)
        for n in it.commits():
            if n == 7:
                it.start()  # from the ledger alone
                it.deliver_the_rest()
        it.deliver_the_rest()
        assert it.core.finished
        each_tuber_once(it, told)
        roles = dict(ledger._db.execute("SELECT role, count(*) FROM observation GROUP BY role"))
        assert sum(roles.values()) == sum(entry.track is not None for log in told.logs.values() for entry in log)
        assert reach_mm < 30.0 or "late_duplicate" not in roles


def test_a_track_of_a_tuber_that_was_committed_in_haste_is_its_duplicate(tmp_path: Path) -> None:
    """Two cameras place a tuber 20 mm apart; the second one's track comes when the marks are just past 15 mm."""
    told = tell(2, cameras=2, apart_m=0.3, n=1, split=0.0).in_run(fresh_run("haste"))
    first, second = told.names
    entry = next(e for e in told.logs[first] if e.track is not None)
    mark = next(e for e in told.logs[first] if e.mark is not None)
    assert entry.track is not None
    assert mark.mark is not None
    place_m = entry.track.place_x_m

    def behind(by_m: float, n: int, camera: str) -> TrackEntry:
        complete = replace(mark.mark, complete_place_x_m=place_m - by_m, final=False)
        return TrackEntry(camera=camera, run=told.run, n=n, track=None, mark=complete)

    other = replace(
        entry.track,
        track_id=f"{told.run}/{second}/0-1",
        travel_m=entry.track.travel_m + 0.020,
    )
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, told, reach_mm=15.0)
        for sent in (
            replace(entry, n=1),
            behind(0.026, 2, first),
            behind(0.026, 1, second),
        ):
            it.core.receive(sent, now_s=it.now_s)
        it.commit()
        assert len(it.tubers()) == 1
        it.core.receive(TrackEntry(camera=second, run=told.run, n=2, track=other, mark=None), now_s=it.now_s)
        it.core.receive(behind(0.2, 3, second), now_s=it.now_s)
        it.core.receive(behind(0.2, 3, first), now_s=it.now_s)
        it.commit()
        assert len(it.tubers()) == 1
        assert it.counts["tracks_late_duplicate"] == 1
        assert "tracks_late" not in it.counts


def _sees(told: Story, name: str, y_m: float) -> bool:
    (camera,) = (c for c in told.cameras if c.name == name)
    return camera.low_y_m <= y_m <= camera.high_y_m


def _low(tubers: list) -> float:
    return min((t.place_x_m for t in tubers), default=float("inf"))


def test_late_counters_are_driven(tmp_path: Path) -> None:
    """Two cameras that see the same belt; the second one comes when the first is long committed."""
    told = tell(5, cameras=3, apart_m=0.1, n=10, split=0).in_run(fresh_run("counters"))
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, told)
        send_all(it, "cam0")
        send_all(it, "cam1")
        it.commit()
        assert it.tubers() == []
        it.now_s += max(STALL_S, STARTUP_GRACE_S) + 0.1
        it.commit()
        assert len(it.tubers()) == len(told.seen())
        it.deliver_the_rest()
        assert it.counts["tracks_late"] == it.counts["tracks_late_duplicate"] == len(told.seen())
        assert len(it.tubers()) == len(told.seen())


def test_a_camera_never_heard_is_waited_for_until_the_line_has_started(tmp_path: Path) -> None:
    told = tell(1, cameras=2).in_run(fresh_run("start"))
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, told)
        send_all(it, "cam0")
        it.now_s += STALL_S + 1
        it.commit()
        assert it.tubers() == []
        it.now_s += STARTUP_GRACE_S
        it.commit()
        assert it.tubers()


def test_a_segmenter_that_is_gone_holds_up_for_half_the_time_only(tmp_path: Path) -> None:
    told = tell(2, cameras=2).in_run(fresh_run("gone"))
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, told)
        send_all(it, "cam0")
        it.receive("cam1", 1)
        it.core.cameras.presence("cam1", alive=False, now_s=it.now_s)
        it.now_s += STALL_S / 2 - 0.5
        it.commit()
        assert it.core.cameras.says(it.now_s)["cam1"] == "running"
        it.now_s += 0.5
        it.commit()
        assert it.core.cameras.says(it.now_s)["cam1"] == "silent"
        assert it.tubers()


def test_marks_that_repeat_an_old_moment_are_no_sign_of_progress(tmp_path: Path) -> None:
    """A segmenter whose camera died goes on repeating its last mark; it must not hold the others up forever."""
    told = tell(3, cameras=2).in_run(fresh_run("frozen"))
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, told)
        mark = next(e for e in told.logs["cam1"] if e.mark is not None)
        send_all(it, "cam1", mark.n)
        from dataclasses import replace

        for n in range(mark.n + 1, mark.n + 30):
            it.now_s += 1.0
            it.core.receive(replace(mark, n=n), now_s=it.now_s)
            it.commit()
        assert it.core.applied()["cam1"] == mark.n + 29
        assert it.core.cameras.says(it.now_s)["cam1"] == "silent"


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("restart", [False, True])
def test_a_camera_that_is_read_to_its_end_before_the_others_counts_nothing_twice(
    seed: int, restart: bool, tmp_path: Path
) -> None:
    """Recordings at full speed, travel to be estimated, cameras along the belt: the one with fewer frames ended while
    its last tracks had no place on the line's travel yet, and was waited for no longer; what they were of was
    committed, and counted again when their place was known.
    """
    told = tell(seed, cameras=2 + seed % 2, estimated=True, spread_m=0.4, length_m=2.0, n=30)
    with Ledger(tmp_path / "ledger.db") as ledger:
        calm = undisturbed(ledger, told)
        for ahead in told.names:
            it = Aggregator(ledger, told.in_run(fresh_run("ahead")))
            send_all(it, ahead)
            it.commit()
            for n in it.commits():
                if restart and n % 7 == 0:
                    it.start()
            it.deliver_the_rest()
            assert it.core.finished
            assert it.canonical() == calm.canonical(), ahead
            assert len(it.tubers()) == len(told.seen())
