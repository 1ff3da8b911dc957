"""More than one layer: what lies hidden is in the estimate and its interval, and a belt in one layer stays as it is."""

from __future__ import annotations

import json
import math
import random
from dataclasses import replace

import pytest

from aggregator.calibration.apply import LAYERS
from aggregator.calibration.load_tickets import load_ticket
from aggregator.calibration.together import OneLoad, together
from aggregator.core.layers import HIDDEN_G_PER_ML, LayerSums
from aggregator.core.load_sums import LoadSums
from aggregator.core.load_told import LoadCounted
from aggregator.core.loads import Load, LoadTicket
from aggregator.core.totals import LoadTotals
from conveyor.layers import layers_in_words, on_others_flag, support_mm_of
from conveyor.messages import Totals, Tuber

ON_BELT = Tuber(1, "r", 0, 0, 0, 170.0, 140.0, 200.0, 70, 60, 50, 3, "pointraft", "m", (), ("a",), ("t",))
UPPER = replace(ON_BELT, flags=(on_others_flag(34.6), "cut"))


def sums_of(tubers: list[Tuber]) -> LoadSums:
    sums = LoadSums(50.0)
    for n, tuber in enumerate(tubers):
        sums.add(replace(tuber, tuber_id=n, place_x_m=-0.03 * n))
    return sums


def message(tubers: list[Tuber], *, coverage: float = 1.0) -> Totals:
    return LoadTotals(sums_of(tubers)).message(
        "r", coverage=coverage, cameras={}, final=True, belt_m=0.03 * len(tubers)
    )


def test_the_flag_says_how_high_a_tuber_lies() -> None:
    assert support_mm_of(UPPER.flags) == 35.0
    assert support_mm_of(ON_BELT.flags) == 0.0
    assert support_mm_of(("on_others_9_mm_more", "xon_others_9_mm")) == 0.0, "only the flag as it is written counts"


def test_a_belt_in_one_layer_says_nothing_of_layers() -> None:
    totals = message([ON_BELT] * 100)
    assert (totals.hidden, totals.hidden_g, totals.layered_m) == (0.0, 0.0, 0.0)
    assert totals.estimated_weight_g == totals.weight_g
    assert (totals.estimated_low_g, totals.estimated_high_g) == pytest.approx((totals.low_g, totals.high_g))
    assert LAYERS not in totals.parts_percent
    assert layers_in_words(totals.hidden, totals.layered_m, totals.belt_m) == ""


@pytest.mark.parametrize("uppers", [1, 2])
def test_a_few_odd_tubers_make_no_layer(uppers: int) -> None:
    assert message([ON_BELT] * 60 + [UPPER] * uppers).hidden_g == 0.0


def test_what_lies_hidden_is_in_the_estimate_and_widens_its_interval() -> None:
    totals = message(([ON_BELT] * 2 + [UPPER]) * 30)
    under_ml = 30 * 3.14159265 / 4 * 70 * 60 / 1.14 * 35 / 1000
    assert totals.hidden_g == pytest.approx(HIDDEN_G_PER_ML * under_ml, rel=1e-6)
    assert totals.estimated_weight_g == pytest.approx(totals.weight_g + totals.hidden_g)
    assert totals.count == 90, "what is estimated is not counted"
    assert totals.low_g < totals.estimated_low_g
    assert totals.high_g == totals.estimated_high_g, "what lies under others passed the camera too"
    assert totals.high_g - totals.weight_g > totals.weight_g - totals.low_g + totals.hidden_g
    assert totals.estimated_low_g > totals.weight_g * 0.8
    said = layers_in_words(totals.hidden, totals.layered_m, totals.belt_m)
    assert said == f"tubers lie in more than one layer on 100 % of the belt: {totals.hidden:.0f} hidden, estimated"


@pytest.mark.parametrize("coverage", [1.0, 0.6])
def test_the_parts_of_the_interval_add_up_and_name_the_layers(coverage: float) -> None:
    totals = message(([ON_BELT] * 2 + [UPPER]) * 30, coverage=coverage)
    half = 100 * (totals.estimated_high_g - totals.estimated_low_g) / 2 / totals.estimated_weight_g
    assert totals.parts_percent[LAYERS] > 1.0
    assert sum(part**2 for part in totals.parts_percent.values()) ** 0.5 == pytest.approx(half, abs=0.03)
    assert totals.estimated_weight_g == pytest.approx((totals.weight_g + totals.hidden_g) / coverage)


@pytest.mark.parametrize("coverage", [None, 0.0, 1e-4, 0.4, 0.93, 1.0])
@pytest.mark.parametrize("tubers", [[UPPER], [ON_BELT, ON_BELT, UPPER] * 30, [ON_BELT] * 40])
@pytest.mark.parametrize("most_m", [None, 30.0])
def test_a_sum_of_one_load_is_that_load(coverage: float | None, tubers: list[Tuber], most_m: float | None) -> None:
    """`ledger totals`, exports and the database told a load in several layers without what lies hidden, 7 % light, and
    with a lower end far below what had been seen where belt was missed; a tuber on belt of which nothing was said to be
    seen was told as tons."""
    load = OneLoad(LoadTotals(sums_of(tubers)), coverage, 12.0, most_m=None if coverage is not None else most_m)
    alone = together([load])
    assert (alone.estimated_g, alone.low_g, alone.high_g) == pytest.approx(load.estimated)
    if alone.low_g > 0 and load.whole == 1.0 and most_m is None:
        squares = sum(part**2 for part in alone.parts_percent.values())
        assert squares**0.5 == pytest.approx(50 * (alone.high_g - alone.low_g) / alone.estimated_g, rel=0.01)
    two = together([load, load])
    assert two.estimated_g == pytest.approx(2 * alone.estimated_g)
    assert two.low_g >= 2 * load.totals.interval_g()[0] - 1e-6, "two loads weigh what was seen of both"


def test_the_ticket_of_a_load_in_layers_knows_that_heaps_differ() -> None:
    """What was reckoned to lie hidden was taken to be exact: a heap looser than others was taken for a factor of the
    line, and made all loads in one layer wrong by it."""
    sums = sums_of([ON_BELT, ON_BELT, UPPER] * 30)
    load = Load(1, "r", 0, "", spans=(("r", 1),), tickets=(LoadTicket(1, 0, "", 16_000.0, 80.0, True),))
    ticket = load_ticket(load, LoadCounted(sums, 1.0, 2.7, {}))
    assert ticket is not None
    under = LoadTotals(sums).hidden()
    assert ticket.estimated_sd_g > math.hypot(under.weight_sd_g, under.support_sd_g)
    flat = load_ticket(load, LoadCounted(sums_of([ON_BELT] * 90), 1.0, 2.7, {}))
    assert flat is not None
    assert flat.estimated_sd_g < 0.02 * flat.estimated_g


def test_only_the_belt_with_layers_is_told_and_the_order_of_tubers_changes_nothing() -> None:
    tubers = [replace(UPPER, place_x_m=-x) for x in (0.05, 0.06, 0.5, 0.52, 2.0)]
    shuffled = random.Random(7).sample(tubers, len(tubers))
    first, second = LayerSums(), LayerSums()
    for a, b in zip(tubers, shuffled, strict=True):
        first.add(a)
        second.add(b)
    assert first == second
    assert first.belt_m() == pytest.approx(0.6, abs=0.2)
    assert LayerSums.from_plain(json.loads(json.dumps(first.plain()))) == first


def test_sums_of_a_ledger_that_knows_no_layers_are_read() -> None:
    sums = LoadSums(50.0)
    sums.add(ON_BELT)
    plain = sums.plain()
    del plain["layers"]
    assert LoadSums.from_plain(plain).same_as(sums)
