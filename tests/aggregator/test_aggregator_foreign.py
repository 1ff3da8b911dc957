"""Clods, stones and haulm: merged by place, counted once, kept in the ledger, told as a share with its interval."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from aggregator.core.foreign import ForeignBody, ForeignSums
from aggregator.core.foreign_odds import chance_of_other
from aggregator.core.foreign_totals import foreign_total, jacket_g
from aggregator.core.load_sums import LoadSums
from aggregator.core.totals import LoadTotals
from aggregator.ledger.audit import audit_run
from aggregator.ledger.check import check_file
from aggregator.ledger.reader import read_bodies, read_sums, read_tubers, reading, the_run
from aggregator.ledger.repair import repair
from aggregator.ledger.rows import body_from, body_row
from aggregator.ledger.schema import FOREIGN
from aggregator.ledger.writer import Ledger
from conveyor.config_yield import ForeignConfig
from conveyor.messages import Totals, TrackEntry
from tests.aggregator.belt_story import Story, tell
from tests.aggregator.test_aggregator_classes import tuber
from tests.aggregator.virtual_line import undisturbed


def body(number: int, *, kind: str = "lump", volume_ml: float = 100.0, log_odds: float | None = -6.0) -> ForeignBody:
    place = -0.1 * number, 0.05
    return ForeignBody(
        number, "r", number * 10**8, *place, kind, 60.0, 50.0, 40.0, volume_ml, ("a",), (f"r/a/{number}-2",), log_odds
    )


def with_others(story: Story, places: set[int]) -> Story:
    """The story in which these of the tubers that are seen are clods to every camera."""
    seen = story.seen()

    def changed(entry: TrackEntry) -> TrackEntry:
        track = entry.track
        if track is None:
            return entry
        off_m = [math.hypot(track.place_x_m - t.x_m, track.y_m - t.y_m) for t in seen]
        if off_m.index(min(off_m)) not in places:
            return entry
        return replace(entry, track=replace(track, kind="lump", log_odds=-5.0, views=(), views_sent=0, views_lost={}))

    return replace(story, logs={camera: [changed(entry) for entry in log] for camera, log in story.logs.items()})


def test_a_row_of_it_comes_back() -> None:
    for found in (body(3), body(4, kind="haulm", log_odds=None)):
        assert body_from(body_row(found)[:-1]) == found


def test_sums_come_back_and_add_up() -> None:
    sums = LoadSums(50.0)
    sums.add(tuber(1, 50.0, 150.0))
    sums.add(replace(tuber(2, 50.0, 150.0), log_odds=2.0))
    sums.add(body(1))
    sums.add(body(2, kind="haulm", log_odds=None))
    again = LoadSums.from_plain(sums.plain())
    assert again.same_as(sums)
    both = again.copy()
    both.take(sums)
    assert (both.count, both.foreign.count) == (4, 4)
    assert both.foreign.bodies == {"lump": [2, 200.0], "haulm": [2, 200.0]}
    assert ForeignSums.from_plain({}).plain() == {}


@pytest.mark.parametrize("log_odds", [-6.0, -0.4, None])
def test_a_load_that_begins_with_clods_alone_is_told(log_odds: float | None) -> None:
    """All of it is foreign, and no share of it more than all. For one in twelve of these volumes it was told as
    100.00000000000001 %, which no message takes, and the aggregator ended at every start.
    """
    for n in range(400):
        sums = LoadSums(50.0)
        sums.add(body(1, volume_ml=20.0 + 0.7 * n, log_odds=log_odds))
        found = foreign_total(LoadTotals(sums), ForeignConfig())
        assert found is not None
        for percent in (found.percent, found.percent_high, found.weight_percent, found.weight_percent_high):
            assert 0 <= percent <= 100, n
        assert found.weight_percent in (0.0, 100.0), n


def test_the_share_is_what_the_classifier_believes() -> None:
    """Ten clods among a hundred bodies; eight others were taken for tubers, and are told by how far below they lie."""
    sums = LoadSums(50.0)
    for k in range(90):
        sums.add(replace(tuber(k + 1, 50.0, 160.0), log_odds=0.8 if k < 8 else 8.2))
    for k in range(10):
        sums.add(body(k + 1, log_odds=-6.2))
    found = foreign_total(LoadTotals(sums), ForeignConfig())
    assert found is not None
    hidden = 8 * chance_of_other(0.75, 8.25)
    assert 4 < hidden < 8
    assert found.count == pytest.approx(10 + hidden, abs=0.05)
    assert found.percent == found.count
    assert found.percent_low < 12 < 18 < found.percent_high
    assert found.kinds == {"lump": 10}
    assert found.weight_g > 10 * 0.7 * 100 * 1.6 + hidden * 160
    heavier = foreign_total(LoadTotals(sums), ForeignConfig(stone_share=1.0))
    assert heavier is not None
    assert heavier.weight_g > 1.3 * found.weight_g
    message = LoadTotals(sums).message("r", coverage=1.0, cameras={}, final=True, foreign=found)
    assert Totals.decode(message.encode()).foreign == found


def test_a_camera_that_makes_all_tubers_doubtful_makes_no_clods_of_them() -> None:
    """The same odds mean a clod where tubers are clear, and a tuber where all of them are like that."""
    assert chance_of_other(2.0, 9.0) > 0.4 > 0.03 > chance_of_other(2.0, 2.5)
    poor = LoadSums(50.0)
    for k in range(100):
        poor.add(replace(tuber(k + 1, 50.0, 160.0), log_odds=3.0 + 0.01 * k))
    found = foreign_total(LoadTotals(poor), ForeignConfig())
    assert found is not None
    assert found.percent < 1


def test_a_clean_load_and_an_empty_one() -> None:
    clean = LoadSums(50.0)
    clean.add(tuber(1, 50.0, 150.0))
    found = foreign_total(LoadTotals(clean), ForeignConfig())
    assert found is not None
    assert (found.count, found.percent, found.weight_g) == (0.0, 0.0, 0.0)
    assert foreign_total(LoadTotals(LoadSums(50.0)), ForeignConfig()) is None


def test_tickets_show_the_soil_jacket() -> None:
    sums = LoadSums(50.0)
    sums.add(body(1))
    foreign = foreign_total(LoadTotals(sums), ForeignConfig())
    assert foreign is not None
    assert jacket_g(10_500.0, 10_000.0, foreign) == pytest.approx(500.0 - foreign.weight_g)
    assert jacket_g(None, 10_000.0, foreign) is None


def test_two_cameras_see_a_clod_once_and_the_ledger_keeps_it(tmp_path: Path) -> None:
    story = with_others(tell(11, n=12, cameras=2), {2, 7})
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        it = undisturbed(ledger, story)
        assert len(it.tubers()) == len(story.seen()) - 2
    with reading(path) as view:
        run = the_run(view, path, None)
        bodies = list(read_bodies(view, run.run))
        assert [found.body_id for found in bodies] == [1, 2]
        assert all(found.kind == "lump" for found in bodies)
        sums = read_sums(view, run.run)
        assert (sums.count(FOREIGN), sums.load.foreign.count, sums.last_body_id) == (2, 2, 2)
        assert audit_run(view, run).faults == ()
        assert len(list(read_tubers(view, run.run))) == len(story.seen()) - 2
    assert check_file(path) == []
    repair(path)
    assert check_file(path) == []
    with reading(path) as view:
        assert list(read_bodies(view, run.run)) == bodies


def test_what_one_camera_takes_for_a_tuber_is_a_tuber(tmp_path: Path) -> None:
    """The camera that refused it adds nothing: neither a body nor to the tuber's size."""
    story = tell(11, n=12, cameras=2)
    first = sorted(story.logs)[0]
    others = with_others(story, {2, 7})
    mixed = replace(story, logs={**story.logs, first: others.logs[first]})
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = undisturbed(ledger, mixed)
        assert len(it.tubers()) == len(story.seen())
    with reading(tmp_path / "ledger.db") as view:
        assert list(read_bodies(view, the_run(view, tmp_path, None).run)) == []
