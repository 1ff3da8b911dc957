"""Tubers that lie lower than in earlier loads: seen beside changes of size, said with its error, kept by the ledger."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aggregator.core.height_change import LEAST_TUBERS, height_changes
from aggregator.core.height_sums import HeightSums
from aggregator.core.load_sums import LoadSums
from aggregator.ledger.check import check_file
from aggregator.ledger.earlier_loads import heights_before
from aggregator.ledger.load_list import told_loads
from aggregator.ledger.load_totals import ReadLoads
from aggregator.ledger.reader import reading
from aggregator.ledger.writer import Ledger
from conveyor.heights import heights_in_words
from conveyor.layers import on_others_flag
from conveyor.messages import Tuber
from tests.aggregator.belt_story import tell
from tests.aggregator.loaded_story import Loads

SEED = 6201
ONE = Tuber(1, "r", 0, 0, 0, 170.0, 140.0, 200.0, 70, 60, 50, 3, "pointraft", "m", (), ("a",), ("t",))


def load(rng: np.random.Generator, *, n: int = 300, lower_mm: float = 0.0, width_mm: float = 65.0) -> list[Tuber]:
    """Tubers whose heights scatter by 6 mm about 5 mm + 0.72 of their width, as in replayed recordings."""
    width = np.maximum(rng.normal(width_mm, 15.0, n), 20.0)
    height = 5.0 + 0.72 * width + rng.normal(0.0, 6.0, n) - lower_mm
    return [replace(ONE, tuber_id=i, width_mm=float(w), height_mm=float(max(h, 1.0)))
            for i, (w, h) in enumerate(zip(width, height, strict=True))]  # fmt: skip


def sums(tubers: list[Tuber]) -> HeightSums:
    found = HeightSums()
    for tuber in tubers:
        found.add(tuber)
    return found


def test_the_order_of_tubers_changes_no_digit() -> None:
    tubers = load(np.random.default_rng(SEED))
    mixed = random.Random(SEED).sample(tubers, len(tubers))
    assert sums(tubers) == sums(mixed)
    parts = LoadSums(50.0)
    for half in (mixed[:100], mixed[100:]):
        one = LoadSums(50.0)
        for tuber in half:
            one.add(tuber)
        parts.take(one)
    assert parts.heights == sums(tubers)
    assert LoadSums.from_plain(parts.plain()).heights == parts.heights


def test_what_is_cut_or_lies_on_others_or_on_end_says_nothing() -> None:
    odd = [replace(ONE, flags=("cut",)), replace(ONE, flags=(on_others_flag(30),)), replace(ONE, height_mm=90.0)]
    assert sums(odd) == HeightSums()


@pytest.mark.parametrize("width_mm", [58.0, 72.0])
def test_an_offset_is_seen_beside_a_change_of_size_and_the_size_alone_is_none(width_mm: float) -> None:
    rng = np.random.default_rng(SEED)
    earlier = [sums(load(rng)) for _ in range(4)]
    (same,) = height_changes(sums(load(rng, width_mm=width_mm)), earlier)
    assert not same.alarm, same
    assert abs(same.lower_mm) < 1.5
    (lower,) = height_changes(sums(load(rng, width_mm=width_mm, lower_mm=4.0)), earlier)
    assert lower.alarm, lower
    assert lower.lower_mm == pytest.approx(4.0, abs=1.0)
    assert 0.4 < lower.lower_sd_mm < 0.8
    assert lower.scale_percent == pytest.approx(0.0, abs=3 * lower.scale_sd_percent)
    assert (lower.loads, lower.tubers) == (4, sum(one.by_cameras["a"][0] for one in earlier))


def test_a_scale_moves_the_slope_and_not_the_intercept() -> None:
    rng = np.random.default_rng(SEED)
    earlier, tubers = [sums(load(rng)) for _ in range(20)], load(rng, n=5000)
    stretched = [replace(t, height_mm=t.height_mm * 1.02, width_mm=t.width_mm * 1.01) for t in tubers]
    ((same,), (scaled,)) = (height_changes(sums(one), earlier) for one in (tubers, stretched))
    assert scaled.scale_percent - same.scale_percent == pytest.approx(1.0, abs=0.1)
    assert abs(scaled.lower_mm - same.lower_mm) < 0.7
    assert not scaled.alarm


@pytest.mark.parametrize("n", [LEAST_TUBERS // 2, 0])
def test_few_tubers_say_nothing(n: int) -> None:
    rng = np.random.default_rng(SEED)
    many, few = sums(load(rng)), sums(load(rng, n=n, lower_mm=6.0))
    assert height_changes(few, [many]) == ()
    assert height_changes(many, [few]) == ()
    assert height_changes(sums([ONE] * 200), [sums([ONE] * 200)]) == (), "all of one size have no slope"


def test_it_is_said_in_words_where_it_matters() -> None:
    rng = np.random.default_rng(SEED)
    earlier = [sums(load(rng)) for _ in range(3)]
    found = height_changes(sums(load(rng, lower_mm=-5.0)), earlier)
    said = heights_in_words(found)
    assert said.startswith(f"under camera a tubers lie {-found[0].lower_mm:.1f} mm higher (± "), said
    assert "than in 3 earlier loads of this variety" in said
    assert heights_in_words(height_changes(sums(load(rng)), earlier)) == ""


def test_the_ledger_keeps_them_by_load_and_compares_what_is_of_a_kind(tmp_path: Path) -> None:
    """Of another variety or another stated offset there is no measure; what an older version summed up has none."""
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        it = Loads(ledger, tell(SEED, n=24, cameras=2, length_m=2.0, noise_mm=0.0))
        for number, (x_m, variety) in enumerate([(-0.4, "Agria"), (-0.8, "agria"), (-1.2, "Fontane"), (-1.6, "Agria")]):
            it.order(f"s{number}", "start", x_m=x_m, fields={"name": f"L{number}", "variety": variety})
        it.deliver_the_rest()
    assert check_file(path) == []
    with reading(path) as view:
        read = ReadLoads(view)
        by_number = read.loads.loads
        assert [len(heights_before(read, by_number[n])) for n in (1, 2, 3, 4)] == [0, 1, 0, 2]
        of_run = next(iter(read.runs))
        whole = HeightSums()
        for own in read.span_sums(of_run).values():
            assert own.load.heights is not None
            whole.take(own.load.heights)
        assert sum(row[0] for row in whole.by_cameras.values()) > 0
        assert all(one["heights"] == [] for one in told_loads(view, limit=9)), "a few tubers say nothing"
        mine = read.span_sums(of_run)[by_number[1].spans[0][1]].load
        old = {name: value for name, value in mine.plain().items() if name != "heights"}
        assert LoadSums.from_plain(old).heights is None
        assert LoadSums.from_plain(old).same_as(mine)
        read.span_sums(of_run)[by_number[1].spans[0][1]].load.heights = None
        assert len(heights_before(read, by_number[4])) == 1
