"""Totals of loads, fields and days: coverage of each load's belt, intervals of sums that hold, tickets of loads."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from aggregator.calibration.apply import CAMERA, RESTING, TUBERS
from aggregator.calibration.tickets import Ticket, read_tickets, write_tickets
from aggregator.calibration.together import OneLoad, together
from aggregator.core.coverage import Moment
from aggregator.core.load_sums import LoadSums
from aggregator.core.load_told import counted, span_coverage
from aggregator.core.loads import Span
from aggregator.core.sight import CameraSight
from aggregator.core.totals import LoadTotals
from aggregator.ledger.at_rest import order_at_rest
from aggregator.ledger.check import check_file
from aggregator.ledger.class_list import told_classes
from aggregator.ledger.load_list import told_loads
from aggregator.ledger.load_totals import Seen
from aggregator.ledger.reader import RunRow, reading
from aggregator.ledger.totals_by import ALL, NOT_TOLD, _harvested_ns, _run_labels, all_loads, totals_by
from aggregator.ledger.writer import Ledger
from aggregator.report import Reporter
from aggregator.scoring.classes import score_classes
from conveyor.config import REPLAY_NAME, AggregatorConfig, LineConfig
from conveyor.contract import read_contract
from conveyor.counters import CounterSet
from conveyor.errors import InputError
from conveyor.messages import LoadOrder, Mark
from tests.aggregator.belt_story import tell
from tests.aggregator.finished_ledger import with_sizes
from tests.aggregator.loaded_story import Loads, S
from tests.aggregator.virtual_line import undisturbed
from tuberline.api.runs import read_totals
from tuberline.cli.calibrate_load import calibrate_load
from tuberline.cli.ticket_options import TicketOptions
from tuberline.export.isoxml.task_data import _partfields
from tuberline.export.tubers import about

DAY_NS = 86_400 * S
CLASSES = '[[classes]]\nname = "small"\nto_mm = 50\n[[classes]]\nname = "large"\nfrom_mm = 50\n'


def mark(s_m: float, looked_m: float) -> Mark:
    return Mark(
        captured_ns=round((100 + s_m / 0.3) * 1e9), travel_m=s_m, travel_estimated=False,
        complete_ns=round((100 + s_m / 0.3) * 1e9), complete_place_x_m=-s_m, final=False,
        looked_at_m=looked_m, travelled_m=s_m, frames={"processed": 1}, views={}, tracks={},
    )  # fmt: skip


def test_belt_that_was_missed_counts_against_its_own_load() -> None:
    """Two cameras with an encoder; one is blind for a metre. Its centre rows lie 0.2 m before the belt's zero."""
    sights = {"a": CameraSight(row_x_m=-0.2), "b": CameraSight(row_x_m=-0.2)}
    for s_m in np.arange(0.0, 12.001, 0.1):
        sights["a"].marked(mark(float(s_m), float(s_m)))
        sights["b"].marked(mark(float(s_m), float(min(s_m, 6.0) + max(0.0, s_m - 7.0))))
    spans = [Span(0, 0, float("inf")), Span(1, 1, -0.2 - 5.0), Span(2, 2, -0.2 - 8.0)]
    sums = LoadSums(50.0)
    sums.seen_by.update({frozenset("a"): 60, frozenset("b"): 40})
    moment = Moment(over=False)
    first, second, third = (span_coverage(spans, at, sums, sights, moment) for at in range(3))
    assert (first.share, first.belt_m) == (1.0, pytest.approx(5.0))
    assert second.belt_m == pytest.approx(3.0)
    assert second.cameras == {"a": 1.0, "b": pytest.approx(2 / 3)}
    assert second.share == pytest.approx(1 - 0.5 / 3, abs=0.03)
    assert second.mean_unseen_m() == {"between_frames": pytest.approx(0.5)}
    assert (third.share, third.belt_m) == (1.0, pytest.approx(4.0))
    whole = counted([(sums, first), (sums, second), (sums, third)])
    assert whole.belt_m == pytest.approx(12.0)
    assert whole.coverage == pytest.approx(1 - 0.5 / 12, abs=0.01)
    assert whole.sums.count == 0


def load_of(weight_g: float, *, tubers: int = 300) -> LoadSums:
    """A load's sums, each tuber with an own error of 10 %."""
    sums = LoadSums(50.0, count=tubers, weighed={("pointraft", "m"): (tubers, weight_g)})
    sums.low_variance_g2 = sums.high_variance_g2 = tubers * (0.1 * weight_g / tubers) ** 2
    sums.squares_g2 = 1.3 * weight_g**2 / tubers
    sums.per_mm_g = 0.022 * weight_g
    return sums


@pytest.mark.parametrize("coverage", [1.0, 0.93])
def test_one_load_is_told_as_it_always_was(coverage: float) -> None:
    totals = LoadTotals(load_of(50e3))
    alone = together([OneLoad(totals, coverage, 60.0)])
    assert (alone.estimated_g, alone.low_g, alone.high_g) == pytest.approx(totals.estimated(coverage, belt_m=60.0))


def test_what_loads_share_does_not_shrink_with_their_number() -> None:
    one = together([OneLoad(LoadTotals(load_of(50e3)), 1.0, 60.0)])
    many = together([OneLoad(LoadTotals(load_of(50e3)), 1.0, 60.0) for _ in range(25)])
    assert many.estimated_g == pytest.approx(25 * one.estimated_g)
    for shared in (RESTING, CAMERA):
        assert many.parts_percent[shared] == pytest.approx(one.parts_percent[shared])
    assert many.parts_percent[TUBERS] < one.parts_percent[TUBERS]
    half = (many.high_g - many.low_g) / 2 / many.estimated_g
    assert half > 0.9 * (one.high_g - one.low_g) / 2 / one.estimated_g, "as if each load had a line of its own"
    mixed = [OneLoad(LoadTotals(load_of(50e3), cultivar=v), 1.0, 60.0, v) for v in ("Agria", "Fontane")]
    same = [OneLoad(LoadTotals(load_of(50e3), cultivar="Agria"), 1.0, 60.0, "Agria") for _ in range(2)]
    assert together(mixed).high_g < together(same).high_g


def test_intervals_of_sums_hold(rng: np.random.Generator) -> None:
    """400 days of 20 loads, drawn as the prior says: what is shared is drawn once a day."""
    days, loads, inside = 400, 20, 0
    for _ in range(days):
        shared = float(np.exp(rng.normal(0, 0.03)) * (1 - 0.022 * rng.normal(0, 4.0)) * np.exp(rng.normal(0, 0.02)))
        true_g = rng.uniform(40e3, 60e3, loads)
        told_g = true_g * shared * np.exp(rng.normal(0, 0.019, loads)) * rng.normal(1, 0.1 / np.sqrt(300), loads)
        day = together([OneLoad(LoadTotals(load_of(float(g))), 1.0, 60.0) for g in told_g])
        inside += day.low_g <= true_g.sum() <= day.high_g
    assert 0.86 <= inside / days <= 0.95


def day_of_loads(
    path: Path, *, seed: int = 5, sized: bool = False, at_end: Callable[[Loads], None] = lambda it: None
) -> None:
    """A run with two loads of two fields and varieties, a day apart, and belt without a load before them."""
    story = tell(seed, n=60, cameras=2, length_m=5.0, noise_mm=0.0)
    story = with_sizes(story) if sized else story
    with Ledger(path) as ledger:
        it = Loads(ledger, story)
        for n in it.commits():
            if n == 2:
                it.order(
                    "a", "start", x_m=-0.6, fields={"name": "A", "field": "Kamp", "variety": "Agria"}, now_ns=DAY_NS
                )
            if n == 5:
                it.order("b", "start", x_m=-2.8, fields={"name": "B", "variety": "Fontane"}, now_ns=2 * DAY_NS)
        assert it.core.finished
        at_end(it)
        ledger.finish(story.run, "{}", sights=it.core.cameras.sights)
        it.order("c", "note", load="B", fields={"field": "Berg"}, now_ns=3 * DAY_NS)


def test_totals_by_what_loads_are_described_by(tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    day_of_loads(path)
    with Ledger(tmp_path / "plain.db") as ledger:
        undisturbed(ledger, tell(6, n=10, cameras=2))
    by = {name: {t.label: t for t in totals_by([path, tmp_path / "plain.db"], name)[0]} for name in
          ("load", "field", "variety", "day", "season")}  # fmt: skip
    assert list(by["load"])[-1] == ALL
    assert {"1 A", "2 B", "story, without a load"} < set(by["load"])
    assert len(by["load"]) == 5
    assert set(by["field"]) == {"Kamp", "Berg", NOT_TOLD, ALL}
    assert set(by["variety"]) == {"Agria", "Fontane", NOT_TOLD, ALL}
    assert {"1970-01-02", "1970-01-03"} < set(by["day"])
    assert set(by["season"]) == {"1970", ALL}
    for totals in by.values():
        parts, whole = [t for label, t in totals.items() if label != ALL], totals[ALL]
        assert sum(t.sums.tubers for t in parts) == whole.sums.tubers
        assert sum(t.sums.estimated_g for t in parts) == pytest.approx(whole.sums.estimated_g)
        assert sum(t.sums.belt_m for t in parts) == pytest.approx(whole.sums.belt_m)
        assert whole.sums.coverage == pytest.approx(1.0)
    with pytest.raises(InputError, match="known are load, field, variety, day, season"):
        totals_by([path], "cultivar")


def test_the_summary_of_a_run_is_the_sum_of_its_loads(tmp_path: Path) -> None:
    """It took the line's cultivar for all of them: 6.67 kg, where its loads, totals and report came to 6.64 kg."""
    (contract := tmp_path / "contract.toml").write_text(CLASSES)
    earlier = Ticket("monday", "m", 10000.0, 20.0, 9000.0, 90.0, 1.0, tubers=60, per_mm_g=198.0, cultivar="Agria")
    write_tickets(tmp_path / "t.json", [earlier])
    config = LineConfig(aggregator=AggregatorConfig(tickets=tmp_path / "t.json", contract=contract))
    told: dict[str, Any] = {}

    def summarise(it: Loads) -> None:
        told.update(Reporter(it.ledger, it.core, config=config, counters=CounterSet()).summary(it.now_s))

    day_of_loads(tmp_path / "ledger.db", sized=True, at_end=summarise)
    *loads, whole = totals_by([tmp_path / "ledger.db"], "load", tickets=[earlier])[0]
    run, sums = told["totals"], whole.sums
    assert run["weight_g"] == pytest.approx(sums.weight_g) == pytest.approx(sum(load.sums.weight_g for load in loads))
    assert (run["low_g"], run["high_g"]) == pytest.approx(sums.seen_g)
    estimated = [run[f"estimated_{name}_g"] for name in ("weight", "low", "high")]
    assert estimated == pytest.approx([sums.estimated_g, sums.low_g, sums.high_g])
    assert run["parts_percent"] == pytest.approx(sums.parts_percent, abs=0.006)
    assert sum(each["weight_g"] for each in run["classes"]) == pytest.approx(sums.weight_g)
    assert run["tickets"] == 1


@pytest.mark.parametrize(
    ("by", "typed", "kept", "gone"), [("variety", "aGRIA ", "Agria", "Fontane"), ("field", " KAMP", "Kamp", "Berg")]
)
def test_loads_of_one_name_are_together_however_it_was_typed(
    tmp_path: Path, by: str, typed: str, kept: str, gone: str
) -> None:
    """'Kamp' and ' kamp' were two fields, in totals, reports and TASKDATA."""
    path = tmp_path / "ledger.db"
    day_of_loads(path)
    both = {t.label: t for t in totals_by([path], by)[0]}
    order_at_rest(path, LoadOrder("d", "note", by="test", load="B", fields={by: typed}))
    one = {t.label: t for t in totals_by([path], by)[0]}
    assert set(both) - set(one) == {gone}
    assert (one[kept].loads, one[ALL].loads) == (both[kept].loads + both[gone].loads, 2) == (2, 2)
    assert one[kept].sums.tubers == both[kept].sums.tubers + both[gone].sums.tubers
    assert set(one) == {kept, NOT_TOLD, ALL}


def test_a_field_is_one_in_taskdata_however_it_was_typed(tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    day_of_loads(path)
    order_at_rest(path, LoadOrder("d", "note", by="test", load="B", fields={"field": " KAMP"}))
    (about_run,) = about([path])["runs"]
    names = [(pair["field"].strip().casefold(), pair["variety"]) for pair in about_run["grown"]]
    assert names == [("kamp", "Agria"), ("kamp", "Fontane")]
    root = ElementTree.Element("ISO11783_TaskData")
    assert list(_partfields(root, about_run["grown"])) == ["kamp"]
    assert [each.get("C") for each in root.iter("PFD")] == ["Kamp"]


def test_tickets_of_loads_calibrate_the_others(tmp_path: Path) -> None:
    """Tubers weigh 8 % more than they read: after one load's ticket the other is told nearer, and narrower."""
    path = tmp_path / "ledger.db"
    day_of_loads(path)
    before = {t.label: t for t in totals_by([path], "load")[0]}
    true_kg = {name: 1.08 * before[name].raw_g / 1000 for name in ("1 A", "2 B")}
    told = subprocess.run(
        [sys.executable, "-m", "tuberline", "load", "ticket", "A", "--kg", f"{true_kg['1 A']:.3f}", "--ledger",
         str(path), "--json"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
    assert json.loads(told.stdout)["done"]
    after = {t.label: t for t in totals_by([path], "load")[0]}
    assert after["1 A"].net_g == pytest.approx(1000 * true_kg["1 A"], abs=1.0)
    assert after["2 B"].sums.tickets == 1
    assert after["2 B"].raw_g == before["2 B"].raw_g
    off = {k: abs(t["2 B"].sums.estimated_g / 1000 / true_kg["2 B"] - 1) for k, t in (("b", before), ("a", after))}
    assert off["b"] == pytest.approx(1 - 1 / 1.08)
    assert off["a"] < 0.03
    assert after["2 B"].sums.high_g - after["2 B"].sums.low_g < before["2 B"].sums.high_g - before["2 B"].sums.low_g
    with reading(path) as view:
        newest, first = told_loads(view, limit=9)
    assert (first["net_g"], newest["net_g"]) == (pytest.approx(1000 * true_kg["1 A"], abs=1.0), None)
    assert first["refused"] == newest["refused"] == []
    assert [said["text"] for said in newest["said"]] == ["began", "field is Berg"]
    assert check_file(path) == []


def test_a_ticket_of_a_load_goes_to_the_file_of_tickets(tmp_path: Path) -> None:
    path, tickets = tmp_path / "ledger.db", tmp_path / "tickets.json"
    day_of_loads(path)
    raw_kg = {t.label: t.raw_g / 1000 for t in totals_by([path], "load")[0]}["2 B"]
    with pytest.raises(InputError, match=r"load 2 \(B\) has no net ticket"):
        calibrate_load(path, load="B", options=TicketOptions(tickets))
    with Ledger(path) as ledger:
        Loads(ledger, tell(5, n=60, cameras=2, length_m=5.0, noise_mm=0.0)).order("t", "ticket", load="B", kg=raw_kg)
    calibrate_load(path, load="B", options=TicketOptions(tickets))
    (ticket,) = read_tickets(tickets)
    assert (ticket.kind, ticket.part, ticket.cultivar, ticket.model) == ("load", "load 2", "Fontane", "m")
    assert ticket.estimated_g == pytest.approx(1000 * raw_kg)
    assert totals_by([path], "load", tickets=read_tickets(tickets))[0][-1].sums.tickets == 1, "it counts once"


def test_what_a_line_is_calibrated_by_holds_for_its_ledger_at_rest(tmp_path: Path) -> None:
    """Tickets and cultivar of the config beside a ledger: its export told 1.922 kg where the line had told 2.300 kg."""
    (tmp_path / "run").mkdir()
    path, tickets = tmp_path / "run" / "ledger.db", tmp_path / "tickets.json"
    (contract := tmp_path / "contract.toml").write_text(CLASSES)
    day_of_loads(path, sized=True)
    before = {t.label: t for t in totals_by([path], "load")[0]}
    earlier = Ticket("monday", "m", 10000.0, 20.0, 9000.0, 90.0, 1.0, tubers=60, per_mm_g=198.0, cultivar="Agria")
    write_tickets(tickets, [earlier])
    (config := tmp_path / "run" / "line.toml").write_text(
        '[cameras.front]\npath = "r"\n[aggregator]\ntickets = "../tickets.json"\ncultivar = "Agria"\n'
    )
    told, refused = totals_by([path], "load")
    after = {t.label: t for t in told}
    assert refused == []
    assert [after[label].sums.tickets for label in after] == [1] * len(after)
    assert [total.sums.estimated_g for total in read_totals(path)] == [total.sums.estimated_g for total in told]
    more = {label: after[label].sums.estimated_g / before[label].sums.estimated_g for label in before}
    assert 1.02 < more["2 B"] < more["1 A"] < 10 / 9, "what a ticket of Agria says of Fontane is less"
    with reading(path) as view:
        grams = {f"{load['number']} {load['name']}": load["estimated_weight_g"] for load in told_loads(view, limit=9)}
    assert grams == {label: pytest.approx(after[label].sums.estimated_g) for label in ("1 A", "2 B")}
    with reading(path) as view:
        classes = told_classes(view, path, read_contract(contract))
    assert [sum(each["weight_g"] for each in one["classes"]) for one in classes] == [
        pytest.approx(after[label].sums.weight_g) for label in ("all", "2 B", "1 A")
    ], "the run's classes were told as weighed"
    tubers = [{"id": "1", "place_x_m": 0.0, "place_y_m": 0.0, "weight_g": 150, "square_mesh_mm": 60}]
    (truth := tmp_path / "truth.json").write_text(json.dumps({"tubers": tubers}))
    scored = score_classes(path, truth=truth, contract=read_contract(contract))
    told_of_run = [{name: each[name] for name in classes[0]["classes"][0]} for each in scored]
    assert told_of_run == classes[0]["classes"]
    assert [each["true_percent"] for each in scored] == [0.0, 100.0]
    config.write_text(config.read_text().replace('"Agria"', '"Fontane"'))
    other = {t.label: t.sums.estimated_g for t in totals_by([path], "load")[0]}
    assert other["story, without a load"] < after["story, without a load"].sums.estimated_g, "of the line's cultivar"
    assert other["1 A"] == after["1 A"].sums.estimated_g, "a load's own comes before the line's"
    tickets.unlink()
    gone, refused = totals_by([path], "load")
    assert [t.sums.estimated_g for t in gone] == [t.sums.estimated_g for t in before.values()]
    assert f"{config} names them, they are left out" in all_loads([path]).doubts[0]
    config.write_text("[aggregator]\ntickts = 1\n")
    assert "tickets and cultivar that it names are left out" in all_loads([path]).doubts[0]
    assert refused == all_loads([path]).refused == [], "it began with 'a ticket does not calibrate: config ...'"


def test_a_ticket_that_cannot_be_of_this_load_is_kept_and_not_used(tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    day_of_loads(path)
    answer = order_at_rest(path, LoadOrder("t", "ticket", load="A", kg=5000.0))
    assert answer.done
    assert "5000.0 kg net on the scale; it is kept, but does not calibrate: the ticket says 5000.0 kg" in answer.text
    assert order_at_rest(path, LoadOrder("u", "ticket", load="A", kg=5000.0, net=False)).text.endswith("on the scale")
    assert "A): 1.31 kg gross on" in order_at_rest(path, LoadOrder("v", "ticket", load="A", kg=1.31, net=False)).text
    totals, refused = totals_by([path], "load")
    assert totals[-1].sums.tickets == 0
    assert totals[-1].weighed == 1
    assert "the ticket says 5000.0 kg" in refused[0]


@pytest.mark.parametrize(
    "order",
    [
        LoadOrder("n", "note", load="1", fields={"name": "x" * 300}),
        LoadOrder("t", "ticket", load="1", kg=6.0, scale_error_kg=math.nan),
        LoadOrder("t", "ticket", load="1", kg=math.inf),
    ],
)
def test_an_order_that_no_line_would_take_is_refused_at_rest(tmp_path: Path, order: LoadOrder) -> None:
    """A name too long for a message was kept, and ended the aggregator at each of its starts."""
    path = tmp_path / "ledger.db"
    day_of_loads(path)
    before = path.read_bytes()
    with pytest.raises(InputError):
        order_at_rest(path, order)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("line", "first_ns", "day"),
    [
        (REPLAY_NAME, 1_792_929_600 * 10**9, "2026-10-25"),
        (REPLAY_NAME, 10_500_000_000, "2026-11-27"),
        (REPLAY_NAME, None, "2026-11-27"),
        ("north", 1_792_929_600 * 10**9, "2026-11-27"),
    ],
    ids=["as its frames are stamped", "stamped from zero", "nothing seen", "a line's own clock"],
)
def test_a_replay_is_of_the_day_that_was_recorded(line: str, first_ns: int | None, day: str) -> None:
    """A load of October that was replayed in November was a harvest of November, in totals, reports and exports."""
    run = RunRow("r", line, ("a",), "", "0", 1_795_780_800 * 10**9, True)
    seen = Seen({"a": CameraSight(first_ns=first_ns)}, Moment(over=True))
    assert _run_labels("r", _harvested_ns(run, seen), None)["day"] == day
