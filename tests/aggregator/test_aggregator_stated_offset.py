"""The resting offset that a run was weighed with: tickets and totals know it without being told, and never twice."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from aggregator.calibration.apply import calibrated
from aggregator.calibration.correction import Prior, prior_told
from aggregator.calibration.load import bucket_ticket, counted, ticket_of
from aggregator.calibration.part import Part
from aggregator.calibration.tickets import Ticket, read_tickets
from aggregator.ledger.load_totals import ReadLoads, ticket_of_load
from aggregator.ledger.reader import reading
from aggregator.ledger.stated import told_belt
from aggregator.ledger.totals_by import totals_by
from aggregator.ledger.writer import Ledger
from conveyor.config import LineConfig, dump_toml, parse_config
from conveyor.errors import InputError
from tests.aggregator.belt_story import tell
from tests.aggregator.loaded_story import Loads
from tests.aggregator.virtual_line import undisturbed
from tuberline.cli.calibrate_bucket import calibrate_bucket
from tuberline.cli.calibrate_show import show
from tuberline.cli.ticket_options import TicketOptions

OFFSET_MM = 6.0


def config(offset_mm: float) -> LineConfig:
    return parse_config(
        {"cameras": {"cam0": {"path": "a"}, "cam1": {"path": "b"}}, "belt": {"resting_offset_mm": offset_mm}},
        where="test",
    )


def run_in(folder: Path, *, ended: bool = True, config_beside: bool = False) -> float:
    """A run on a line that states `OFFSET_MM`; grams of its tubers."""
    folder.mkdir()
    with Ledger(folder / "ledger.db") as ledger:
        it = undisturbed(ledger, tell(11, n=40, cameras=2))
        if ended:
            ledger.finish(it.story.run, json.dumps({"belt": told_belt(config(OFFSET_MM))}))
        weighed_g = sum(tuber.weight_g for tuber in it.tubers())
    if config_beside:
        (folder / "line.toml").write_text(dump_toml(config(OFFSET_MM)), encoding="utf-8")
    return weighed_g


@pytest.mark.parametrize("ended", [True, False])
def test_a_bucket_knows_the_offset_of_its_run_and_totals_say_what_the_scale_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], ended: bool
) -> None:
    """Who did not type --resting-offset-mm had a ticket of a line that states none: the offset was taken off again from
    every load, 9 % at 5 mm, while the command said that loads are multiplied with 0.99. A run that had not ended (its
    line was cut off) was taken for one without an offset whatever was typed."""
    weighed_g = run_in(tmp_path / "run", ended=ended, config_beside=not ended)
    path = tmp_path / "tickets.json"
    calibrate_bucket(tmp_path / "run", kg=weighed_g / 1000, options=TicketOptions(path), json=True)
    told = json.loads(capsys.readouterr().out)
    assert told["ticket"]["stated_offset_mm"] == OFFSET_MM
    whole = totals_by([tmp_path / "run"], "load", tickets=read_tickets(path))[0][-1].sums
    assert whole.weight_g == pytest.approx(told["load_factor"]["factor"] * weighed_g, rel=1e-3)
    assert whole.weight_g == pytest.approx(weighed_g, rel=0.005)
    show(path, json=True)
    (table,) = json.loads(capsys.readouterr().out)
    assert table["tickets"][0]["apart_percent"] == pytest.approx(0.0, abs=0.5), "the ticket is as its line expects"


def test_an_offset_that_the_run_was_not_weighed_with_is_refused(tmp_path: Path) -> None:
    weighed_g = run_in(tmp_path / "run")
    for given in (None, OFFSET_MM):
        found = ticket_of(tmp_path / "run", run=None, ticket_g=weighed_g, ticket_sd_g=1.0, stated_offset_mm=given)
        assert found.stated_offset_mm == OFFSET_MM
    with pytest.raises(InputError, match=r"was weighed with a resting offset of 6 mm, --resting-offset-mm says 5"):
        ticket_of(tmp_path / "run", run=None, ticket_g=weighed_g, ticket_sd_g=1.0, stated_offset_mm=5.0)


def test_a_bucket_holds_when_the_line_says_that_its_belt_is_a_web(tmp_path: Path) -> None:
    """The bucket had found the sink between the rods as an offset; each tuber's own sink came on top of it."""
    web = {"surface": "rods", "rod_pitch_mm": 40.0, "rod_diameter_mm": 11.0, "resting_offset_mm": 0.0}
    prior = prior_told(web)
    assert prior.stated_offset_mm == pytest.approx(3.5, abs=0.1)
    assert prior_told({**web, "surface": "flat"}).stated_offset_mm == 0.0
    assert prior_told({**web, "resting_offset_mm": 1.0}).stated_offset_mm == pytest.approx(prior.stated_offset_mm + 1)
    # Told as flat it read light by what the sink is worth; told as a web it reads what the scale says.
    lost_g = 22.0 * prior.stated_offset_mm
    bucket = Ticket("b", "m", 1000.0, 0.1, 1000.0 - lost_g, 0.1, 1.0, kind="bucket", per_mm_g=22.0)
    told = {
        name: calibrated({("pointraft", "m"): g}, per_mm_g=22.0, own_variance_g2=(0, 0), tickets=[bucket], prior=p)
        for name, g, p in (("flat", 1000.0 - lost_g, Prior()), ("web", 1000.0, prior))
    }
    assert told["flat"].weight_g == pytest.approx(1000.0, rel=0.01)
    assert told["web"].weight_g == pytest.approx(1000.0, rel=0.01), "1076 where the sink counted twice"
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        story = undisturbed(ledger, tell(11, n=40, cameras=2)).story
        ledger.finish(story.run, json.dumps({"belt": {**web, "resting_offset_mm": 1.0}}))
    assert counted(path, run=None).stated_offset_mm == pytest.approx(prior.stated_offset_mm + 1)
    with pytest.raises(InputError, match=r"with a resting offset of 1 mm, --resting-offset-mm says 0"):
        ticket_of(path, run=None, ticket_g=9e3, ticket_sd_g=1.0, stated_offset_mm=0.0)


def test_where_nothing_says_the_offset_it_is_the_one_given(tmp_path: Path) -> None:
    weighed_g = run_in(tmp_path / "run", ended=False)
    assert counted(tmp_path / "run", run=None).stated_offset_mm is None

    def ticket(offset_mm: float | None) -> Ticket:
        found, _ = bucket_ticket(
            tmp_path / "run", run=None, part=Part(), ticket_g=weighed_g, ticket_sd_g=1.0, stated_offset_mm=offset_mm
        )
        return found

    assert [ticket(given).stated_offset_mm for given in (None, 5.5)] == [0.0, 5.5]


def test_a_load_that_went_on_under_another_offset_was_weighed_with_both(tmp_path: Path) -> None:
    """All of it was taken to be weighed with the offset that the line stated at its start: a trailer that was resumed
    after the offset had been corrected in the line's file calibrated the line wrong by a part of it."""
    path = tmp_path / "ledger.db"
    with Ledger(path) as ledger:
        for seed, offset_mm, order in ((5, 0.0, {"fields": {"name": "A"}}), (6, OFFSET_MM, {"load": "1"})):
            it = Loads(ledger, tell(seed, n=24, cameras=2, run=f"run{seed}"))
            it.stated_mm = offset_mm
            it.order(f"start{seed}", "start", x_m=float("1e6"), **order)
            it.commit_one_by_one()
            ledger.finish(it.story.run, json.dumps({"belt": told_belt(config(offset_mm))}))
        grams = [sum(tuber.weight_g for tuber in ledger.tubers(run)) for run in ("run5", "run6")]
        worth = [ledger.sums(run).load.per_mm_g for run in ("run5", "run6")]
        it.order("t", "ticket", load="1", kg=sum(grams) / 1000)
    mean_mm = OFFSET_MM * worth[1] / sum(worth)
    assert ticket_of_load(path, "1").stated_offset_mm == pytest.approx(mean_mm)
    with reading(path) as view:
        assert ReadLoads(view).prior("run6").stated_offset_mm == OFFSET_MM
    load = totals_by([path], "load")[0][0]
    assert load.sums.weight_g == pytest.approx(sum(grams), rel=0.01), "the scale said what was weighed"
