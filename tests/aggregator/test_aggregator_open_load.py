"""A load is open while its line runs and counts to it, no longer; till then its ticket is held against nothing."""

from __future__ import annotations

from pathlib import Path

from aggregator.ledger.load_list import told_loads
from aggregator.ledger.load_totals import ReadLoads, tickets_of
from aggregator.ledger.reader import reading
from aggregator.ledger.writer import Ledger
from tests.aggregator.loaded_story import Loads, story
from viewer.page.state import ToldLoad


def test_a_ticket_of_an_open_load_waits_for_its_end(tmp_path: Path) -> None:
    """It was refused, taken and refused again as the load grew past it: of 22.6 kg on the belt 15.5 were told, as known
    to 7 %, and other loads moved with it.
    """
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        it = Loads(ledger, story())
        it.order("a", "start", x_m=-0.1, fields={"name": "A"})
        told = []
        for n in it.commits():
            if n == 3:
                it.order("t", "ticket", load="A", kg=1.5)
            with reading(path) as view:
                (load,) = told_loads(view, limit=9)
                told.append((load["open"], load["calibrated_by"], tickets_of(read := ReadLoads(view), read.seen)[0]))
            if n > 3:
                assert load["refused"] == [
                    "load 1 (A) is still open: a ticket is held against all of it, once it has ended"
                ]
            if it.core.cameras.final or n == 6:
                break
        assert told == [(True, "", [])] * len(told)
        it.order("e", "end", x_m=min(it.core.watermark_x_m, -1.0) - 0.001)
        with reading(path) as view:
            (load,) = told_loads(view, limit=9)
            assert not load["open"]
            assert "still open" not in " ".join(load["refused"])


def test_a_load_whose_line_was_stopped_is_open_no_more(tmp_path: Path) -> None:
    """It stood there as open for good, and no end was taken for it."""
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        it = Loads(ledger, story())
        it.order("a", "start", x_m=-0.1, fields={"name": "A"})
        for n in it.commits():
            if n == 5:
                break
        with reading(path) as view:
            assert told_loads(view, limit=9)[0]["open"]
    with reading(path) as view:
        assert not told_loads(view, limit=9)[0]["open"]


def test_the_page_tells_a_load_as_all_of_its_belt_weighs(tmp_path: Path) -> None:
    """Its list said 18.0 kg where `load show` said 18.9, and a right ticket lay outside of the interval."""
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        it = Loads(ledger, story())
        it.order("a", "start", x_m=-0.1, fields={"name": "A"})
        it.commit_one_by_one()
    with reading(path) as view:
        (load,) = told_loads(view, limit=9)
    shown = ToldLoad.of({**load, "estimated_weight_g": 9e3, "estimated_low_g": 8e3, "estimated_high_g": 11e3})
    assert (shown.low_g, shown.weight_g, shown.high_g) == (8e3, 9e3, 11e3)
    unseen = ToldLoad.of({**load, "weight_g": None, "low_g": None, "high_g": None})
    assert (unseen.low_g, unseen.weight_g, unseen.high_g) == (None, None, None)
    unseen = ToldLoad.of({**load, "count": 0, "coverage": None, "estimated_weight_g": 0.0})
    assert (unseen.low_g, unseen.weight_g, unseen.high_g) == (None, None, None), "not 0 kg, and surely so"
