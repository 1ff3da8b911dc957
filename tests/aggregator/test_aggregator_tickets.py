"""Load tickets: the factor that follows from them, what it is still worth, and tickets that are refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aggregator.calibration.apply import load_factor
from aggregator.calibration.correction import LOAD_SDS
from aggregator.calibration.load import ticket_of
from aggregator.calibration.part import Part
from aggregator.calibration.tickets import Ticket, check_ticket, read_tickets, set_aside, with_ticket, write_tickets
from aggregator.ledger.line_tickets import with_own
from aggregator.ledger.writer import Ledger
from conveyor.errors import InputError
from tests.aggregator.belt_story import tell
from tests.aggregator.virtual_line import undisturbed

MODEL = "tuberline-sim@00000000"


def ticket(ratio: float, *, run: str = "monday", model: str = MODEL, coverage: float = 1.0) -> Ticket:
    return Ticket(run, model, 1e6 * ratio, 1000.0, 1e6, 3000.0, coverage)


def test_without_a_ticket_nothing_is_known_and_one_ticket_tells_most_of_it() -> None:
    assert load_factor([], MODEL) is None
    one = load_factor([ticket(0.95)], MODEL)
    assert one is not None
    # The prior pulls a single ratio a little towards 1.
    assert 0.95 < one.factor < 0.955
    assert one.half_width < 0.05


def test_more_tickets_come_closer_but_never_below_what_loads_differ_by() -> None:
    widths = []
    for n in (1, 3, 10, 100):
        found = load_factor([ticket(0.95, run=str(k)) for k in range(n)], MODEL)
        assert found is not None
        widths.append(found.half_width)
    assert widths == sorted(widths, reverse=True)
    assert widths[-1] >= 1.64 * LOAD_SDS[0]
    assert found.factor == pytest.approx(0.95, abs=0.001)


def test_loads_that_scatter_more_than_assumed_widen_the_interval() -> None:
    calm = load_factor([ticket(ratio, run=str(ratio)) for ratio in (0.95, 0.951, 0.949, 0.95)], MODEL)
    wild = load_factor([ticket(ratio, run=str(ratio)) for ratio in (0.88, 1.02, 0.91, 0.99)], MODEL)
    assert calm is not None
    assert wild is not None
    assert wild.half_width > 2 * calm.half_width


def test_nine_of_ten_loads_lie_inside_the_interval() -> None:
    """Simulated seasons: a bias each, loads that differ by 1.5 %; the next load is held against the interval."""
    rng = np.random.default_rng(20)
    inside = 0
    for _ in range(300):
        bias = rng.normal(0.0, 0.05)
        ratios = np.exp(bias + rng.normal(0.0, math.hypot(0.015, 0.0032), 4))
        found = load_factor([ticket(ratio, run=str(n)) for n, ratio in enumerate(ratios[:3])], MODEL)
        assert found is not None
        inside += abs(math.log(ratios[3] / found.factor)) <= found.half_width
    assert 261 <= inside <= 291, inside


def test_tickets_of_other_weights_do_not_count() -> None:
    assert load_factor([ticket(0.9, model="other@1")], MODEL) is None


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        (ticket(0.001), "same load, net, in kilograms"),
        (ticket(1.0, coverage=0.5), "50 % of the belt"),
        (ticket(1.0, coverage=0.7996), r"79\.9 % of the belt were looked at, a ticket needs at least 80 %"),
        (ticket(1.0, coverage=0.0), "how much of its belt was looked at is not known, a ticket needs at least 80 %"),
        (Ticket("r", MODEL, 1e6, 0, 0.0, 0, 1.0), "counted no tuber"),
        (Ticket("r", MODEL, -5.0, 0, 1e6, 0, 1.0), "above 0 kg"),
        (Ticket("r", MODEL, 1e6, -10.0, 1e6, 0, 1.0), r"scale's error is -0\.01 kg"),
        (Ticket("r", MODEL, 1e6, math.nan, 1e6, 0, 1.0), "scale's error is nan kg"),
        (Ticket("r", MODEL, 1e6, 0, 1e6, 0, 1.0, stated_offset_mm=math.nan), "resting offset of run r is nan mm"),
    ],
)
def test_a_ticket_of_another_load_is_refused(bad: Ticket, says: str) -> None:
    with pytest.raises(InputError, match=says):
        check_ticket(bad)


def test_a_run_has_one_ticket_and_a_file_comes_back_as_it_was(tmp_path: Path) -> None:
    known = with_ticket((), ticket(0.95), again=False)
    with pytest.raises(InputError, match="--again"):
        with_ticket(known, ticket(0.96), again=False)
    known = with_ticket(known, ticket(0.96), again=True)
    path = tmp_path / "tickets.json"
    write_tickets(path, known)
    assert read_tickets(path) == known


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"format": 3, "tickets": []}',
        '{"format": 2, "tickets": [{"run": "x"}]}',
        '{"format": 1, "tickets": [{"run": "x"}]}',
        "[" * 5000,
    ],
)
def test_a_file_that_is_none_is_refused_by_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "tickets.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"tickets\.json"):
        read_tickets(path)


def test_a_figure_that_is_none_is_named(tmp_path: Path) -> None:
    path = tmp_path / "tickets.json"
    write_tickets(path, (ticket(0.95),))
    raw = json.loads(path.read_text())
    raw["tickets"][0]["ticket_sd_g"] = "much"
    path.write_text(json.dumps(raw))
    with pytest.raises(InputError, match="ticket_sd_g is 'much'"):
        read_tickets(path)
    write_tickets(path, (ticket(0.95), ticket(0.96)))  # a line that was copied by hand counted twice
    with pytest.raises(InputError, match=r"ticket 1 is of load of run .*, as ticket 0 is: .* would count twice"):
        read_tickets(path)


def test_a_file_of_version_0_1_is_read_as_loads(tmp_path: Path) -> None:
    old = {
        "run": "monday",
        "model": MODEL,
        "ticket_g": 950000.0,
        "ticket_sd_g": 1000.0,
        "estimated_g": 1000000.0,
        "estimated_sd_g": 3000.0,
        "coverage": 1.0,
    }
    path = tmp_path / "tickets.json"
    path.write_text(json.dumps({"format": 1, "tickets": [old]}))
    (found,) = read_tickets(path)
    assert found == ticket(0.95)
    assert found.grams_per_mm == pytest.approx(0.020 * 1e6)
    write_tickets(path, (found,))
    assert json.loads(path.read_text())["format"] == 2
    assert read_tickets(path) == (found,)


def test_a_ticket_is_set_aside_for_a_reason_that_is_kept_and_taken_back(tmp_path: Path) -> None:
    known = (ticket(0.95), ticket(1.2, run="tuesday"))
    aside = set_aside(known, "tuesday", kind=None, reason="the trailer was half full of soil")
    path = tmp_path / "tickets.json"
    write_tickets(path, aside)
    kept = read_tickets(path)
    assert kept[1].set_aside == "the trailer was half full of soil"
    assert load_factor(kept, MODEL) == load_factor(known[:1], MODEL)
    assert set_aside(kept, "tuesday", kind=None, reason="") == known
    with pytest.raises(InputError, match="load of run monday; load of run tuesday"):
        set_aside(known, "friday", kind=None, reason="x")


def test_of_several_tickets_of_a_run_one_is_chosen_by_its_part() -> None:
    known = tuple(
        replace(ticket(ratio), kind="bucket", part=part) for ratio, part in ((0.9, "0 to 1 m"), (1.0, "load 2"))
    )
    with pytest.raises(InputError, match=r"--kind, --part among: bucket of run monday, 0 to 1 m; bucket of run monday"):
        set_aside(known, "monday", kind="bucket", reason="x")
    aside = set_aside(known, "monday", kind="bucket", part="load 2", reason="x")
    assert [one.set_aside for one in aside] == ["", "x"]
    with pytest.raises(InputError, match="no ticket of bucket of run 'monday', part 'load 3'"):
        set_aside(known, "monday", kind="bucket", part="load 3", reason="x")


def test_a_ticket_of_a_ledger_knows_its_run_weights_and_coverage(tmp_path: Path) -> None:
    told = tell(3)
    with Ledger(tmp_path / "ledger.db") as ledger:
        run = undisturbed(ledger, told).story.run
        weighed_g = sum(tuber.weight_g for tuber in ledger.tubers(run))
        models = {tuber.model for tuber in ledger.tubers(run)}
    found = ticket_of(tmp_path, run=run, ticket_g=weighed_g, ticket_sd_g=1.0)
    assert found.run == run
    assert {found.model} == models
    assert found.estimated_g == pytest.approx(weighed_g / found.coverage, rel=1e-6)
    assert 0 < found.estimated_sd_g < 0.2 * weighed_g


def test_a_whole_run_holds_its_loads() -> None:
    """A ticket for all of a run and tickets for two of its loads stood side by side, and each tuber counted twice."""
    whole = replace(ticket(0.95), kind="load", part="")
    loads = [replace(whole, part=f"load {n}", ticket_g=whole.ticket_g / 2) for n in (1, 2)]
    assert len(with_ticket(with_ticket((), loads[0], again=False), loads[1], again=False)) == 2
    with pytest.raises(InputError, match="hold the same tubers"):
        with_ticket((whole,), loads[0], again=False)
    with pytest.raises(InputError, match="hold the same tubers"):
        with_ticket(tuple(loads), whole, again=False)
    assert with_ticket(tuple(loads), whole, again=True) == (whole,)
    assert with_own([whole, replace(whole, run="another")], loads) == [replace(whole, run="another"), *loads]


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (Part(), Part(first=3, last=9), True),
        (Part(first=1, last=12), Part(first=12, last=20), True),
        (Part(first=1, last=12), Part(first=13, last=20), False),
        (Part(first=13), Part(first=1, last=12), False),
        (Part(from_x_m=-1.0, to_x_m=-2.5), Part(from_x_m=-2.4, to_x_m=-9.0), True),
        (Part(from_x_m=-1.0, to_x_m=-2.5), Part(from_x_m=-2.5), False),
    ],
)
def test_no_tuber_counts_in_two_tickets_of_a_kind(one: Part, other: Part, same: bool) -> None:
    """Two buckets, the second one told as reaching back into the first, counted their common tubers twice."""
    assert (Part.named(one.name), Part.named(other.name)) == (one, other)
    assert one.overlaps(other) == other.overlaps(one) == same
    first, second = (replace(ticket(0.95), kind="bucket", part=part.name) for part in (one, other))
    if not same:
        assert len(with_ticket((first,), second, again=False)) == 2
        return
    with pytest.raises(InputError, match="the same tubers"):
        with_ticket((first,), second, again=False)
    assert with_ticket((first,), second, again=True) == (second,)
    assert len(with_ticket((first,), replace(second, run="another"), again=False)) == 2
    assert len(with_ticket((first,), replace(second, kind="tubers", singles=()), again=False)) == 2


def test_parts_by_numbers_and_by_places_are_not_mixed() -> None:
    """Nothing tells whether they hold the same tubers, and such a bucket counted twice in silence."""
    numbers, places = Part(first=1, last=12), Part(from_x_m=-2.4)
    assert numbers.overlaps(places) is None
    assert places.overlaps(numbers) is None
    first, second = (replace(ticket(0.95), kind="bucket", part=part.name) for part in (numbers, places))
    with pytest.raises(InputError, match=r"may hold the same tubers.*both by numbers or both by places"):
        with_ticket((first,), second, again=False)
    assert with_ticket((first,), second, again=True) == (second,)
    both = Part(first=1, last=12, from_x_m=-2.4)
    assert both.overlaps(numbers)
    assert both.overlaps(places)
