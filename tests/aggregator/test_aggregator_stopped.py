"""What a stopped or a running line is said to have seen is the same by whoever says it: its summary, or its ledger."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aggregator.calibration.load import ticket_of
from aggregator.calibration.tickets import write_tickets
from aggregator.core.coverage import Moment, at_rest, coverage
from aggregator.core.sight import CameraSight
from aggregator.ledger.load_totals import ReadLoads, Seen
from aggregator.ledger.loads import last_loads
from aggregator.ledger.reader import coverage_of, moment_of, read_runs, read_sums, reading, run_being_written
from aggregator.ledger.receipt import is_being_written
from aggregator.ledger.writer import Ledger
from conveyor import topics
from conveyor.config import AggregatorConfig, LineConfig, dump_toml
from conveyor.delivery.kept import KeptPublisher
from conveyor.messages import CameraInfo
from conveyor.node import Node
from tests.aggregator.belt_story import tell
from tests.aggregator.loaded_story import S
from tests.aggregator.looking_story import START_NS, look, positions_m, some_outages
from tests.aggregator.test_aggregator_load_orders import loader
from tests.aggregator.test_aggregator_node import Process, Segmenters, camera_info, line, process
from tests.aggregator.virtual_line import Aggregator, fresh_run
from tests.conftest import wait_until
from tests.written_run import write_run
from tuberline.api.runs import read_totals

__all__ = ["line", "process"]


@pytest.mark.parametrize("estimated", [False, True])
def test_histories_at_rest_say_what_was_known_when_the_line_stopped(estimated: bool, rng: np.random.Generator) -> None:
    """How far the belt ran after the newest mark, and belt whose tubers are in no ledger yet, are kept with them."""
    differing = 0
    for _ in range(200):
        belt_m = positions_m(rng, rng.uniform(8, 40), steady=estimated)
        if belt_m[-1] < 1.0:
            continue
        seconds = (len(belt_m) - 1) / 30.0
        sights = {
            name: look(belt_m, some_outages(rng, seconds), estimated=estimated, final=False, name=name).sight
            for name in ("a", "b")[: int(rng.integers(1, 3))]
        }
        now_ns = START_NS + round((seconds + rng.uniform(0, 20)) * 1e9)
        moment = Moment(
            over=True,
            until_ns={name: now_ns for name in sights if rng.random() < 0.6},
            ran_m={name: float(rng.uniform(0, 3)) for name in sights if rng.random() < 0.3},
            waiting_m={name: float(rng.uniform(0, 0.5)) for name in sights if rng.random() < 0.5},
        )
        seen_by = {frozenset(sights): 5}
        told = coverage(sights, seen_by=seen_by, moment=moment)
        kept = {
            n: CameraSight.from_plain(json.loads(json.dumps(s.plain()))) for n, s in at_rest(sights, moment).items()
        }
        read = coverage(kept, seen_by=seen_by, moment=Moment(over=True))
        assert read.belt_m == pytest.approx(told.belt_m, abs=1e-6)
        assert read.share == pytest.approx(told.share, abs=1e-6)
        assert read.mean_unseen_m() == pytest.approx(told.mean_unseen_m(), abs=1e-5)
        differing += coverage(sights, seen_by=seen_by, moment=Moment(over=True)).share != told.share
    assert differing > 20, "the moment made no difference: the test tests nothing"


def test_a_ledger_is_read_as_that_of_a_line_that_runs_while_one_writes_it(tmp_path: Path) -> None:
    """Belt that the log has not come to yet was told as not seen: 42 % where the page said 100 %."""
    path = tmp_path / "ledger.db"
    told = tell(5, cameras=2, n=20, length_m=2.0)
    with Ledger(path) as ledger:
        it = Aggregator(ledger, told.in_run(fresh_run("now")))
        for published in (state.sight.published for state in it.core.cameras.states.values()):
            published.take(
                replace(camera_info("cam0", first_s=0.0, last_s=60.0), first_travel_m=0.0, last_travel_m=9.0)
            )
        for n in it.commits():
            if n == 8:
                break
        assert is_being_written(path)
        with reading(path) as view:
            (run,) = read_runs(view)
            assert not moment_of(run, run_being_written(view)).over
            running = coverage_of(run, read_sums(view, run.run), moment_of(run, run_being_written(view)))
            assert ReadLoads(view).whole(run).coverage == running.share == 1.0
    assert not is_being_written(path)
    with reading(path) as view:
        assert moment_of(run, run_being_written(view)).over
        assert (coverage_of(run, read_sums(view, run.run), moment_of(run, run_being_written(view))).share or 0.0) < 0.9
    with Ledger(path) as ledger:  # the next run has begun, and no camera has said anything
        ledger.open_run("next", line=run.line, cameras=run.cameras, version="1", started_ns=run.started_ns + 1)
        with reading(path) as view:
            assert run_being_written(view) == "next"
            assert (ReadLoads(view).whole(run).coverage or 0.0) < 0.9, "the stopped run was told as one that goes on"
        ledger.stopped("next", {})
        ledger.stopped("now", it.core.cameras.sights)
        ledger.open_run("now", line=run.line, cameras=run.cameras, version="1", started_ns=run.started_ns)
        with reading(path) as view:
            assert run_being_written(view) == "now", "it goes on, and the one that was begun after it was told"
        ledger.stopped("now", it.core.cameras.sights)
        ledger.open_run("next", line=run.line, cameras=run.cameras, version="1", started_ns=run.started_ns + 1)
        with reading(path) as view:
            assert run_being_written(view) == "next"
        new = ledger.run_row("next")
        assert new is not None
        assert Seen.at_rest(new, ledger.sums("next")).sights.keys() == set(run.cameras), "cameras that never looked"


def test_a_ledger_knows_of_a_run_that_it_was_stopped_until_it_goes_on(tmp_path: Path) -> None:
    path, story = tmp_path / "ledger.db", tell(5, cameras=1, n=20, length_m=2.0)
    known = []
    with Ledger(path) as ledger:
        it = Aggregator(ledger, story.in_run(fresh_run("now")))
        for n in it.commits():
            with reading(path) as view:
                known.append(read_sums(view, it.core.run).stopped)
            if n == 3:
                ledger.stopped(it.core.run, it.core.cameras.sights)
                with reading(path) as view:
                    assert read_sums(view, it.core.run).stopped
    assert len(known) > 5
    assert not any(known)


def test_a_line_that_is_stopped_again_and_again_has_seen_what_it_saw(tmp_path: Path) -> None:
    """Belt whose tubers waited for the other camera was taken off once more at each stop."""
    story, seen, waiting = tell(5, cameras=2, n=20, length_m=2.0), [], []
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, story.in_run(fresh_run("now")))
        for name, entries in zip(story.names, (20, 10), strict=True):
            for n in range(1, entries + 1):
                it.receive(name, n)
        it.commit()
        for _ in range(3):
            moment = it.core.cameras.moment(it.now_s, over=True, waiting_m=it.core.waiting_m())
            ledger.stopped(it.core.run, at_rest(it.core.cameras.sights, moment))
            kept = ledger.sums(it.core.run).sights
            seen.append(coverage(kept, seen_by={}, moment=Moment(over=True)).cameras)
            waiting.append(max(it.core.waiting_m().values()))
            it.start()
    assert min(waiting) > 0.05, "no tuber waits: the test tests nothing"
    for again in seen[1:]:
        assert again == pytest.approx(seen[0], abs=0.002)


def test_who_asks_whether_a_ledger_is_written_keeps_no_writer_out(tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    assert not is_being_written(path)
    for _ in range(20):
        with Ledger(path):
            assert is_being_written(path)
        assert not is_being_written(path)


@pytest.mark.graph
@pytest.mark.timeout(120)
def test_a_stopped_line_has_one_coverage(line: tuple[LineConfig, Path], process: Process) -> None:
    """In summary.json belt after the last mark was not seen, in the ledger, its exports and reports there was none."""
    config, _ = line
    told = tell(13, cameras=2, n=30, length_m=3.0)
    with Node("segmenter", "cam0", config=config, run="story") as node:
        segmenters = Segmenters(node, told)
        infos = {name: KeptPublisher(node, topics.CAMERA_INFO, camera=name) for name in told.names}
        wait_until(lambda: segmenters.all_acknowledged(0), what="the first acknowledgement", timeout_s=40)
        for name, out in infos.items():
            said: CameraInfo = camera_info(name, first_s=0.0, last_s=9.0)
            out.put(replace(said, first_travel_m=-0.15, last_travel_m=6.0))
        segmenters.deliver(14)
        process.popen.terminate()
        code, text = process.end()
        assert code in (0, -15), text
    summary = json.loads((config.aggregator.out / "summary.json").read_text())
    assert summary["unseen_m"]["after_last_frame"] > 0.1
    with reading(config.aggregator.out / "ledger.db") as view:
        (run,) = read_runs(view)
        read = coverage_of(run, read_sums(view, run.run), moment_of(run, run_being_written(view)))
        assert read_sums(view, run.run).stopped
        whole = ReadLoads(view).whole(run)
        (told_run,) = last_loads(view, limit=3)
    stopped = {name: summary["totals"][name] for name in ("count", "weight_g", "low_g", "high_g", "coverage")}
    assert 0 < stopped["low_g"] < stopped["weight_g"] < stopped["high_g"]
    for name, value in stopped.items():
        assert told_run[name] == pytest.approx(value, abs=1e-6), name
    assert read.share == pytest.approx(summary["coverage"], abs=1e-6)
    assert read.belt_m == pytest.approx(summary["belt_m"], abs=1e-6)
    assert read.mean_unseen_m() == pytest.approx(summary["unseen_m"], abs=1e-5)
    assert whole.coverage == read.share


def test_runs_that_were_stopped_are_told_with_their_interval(tmp_path: Path) -> None:
    """The page's earlier runs and `status` had their weight before any ticket, and neither interval nor coverage."""
    path, story = tmp_path / "ledger.db", tell(5, cameras=1, n=20, length_m=2.0)
    with Ledger(path) as ledger:
        it = Aggregator(ledger, story.in_run(fresh_run("now")))
        it.commit_one_by_one()
        now = it.core.run
        ledger.stopped(now, it.core.cameras.sights)
        ledger.open_run("empty", line="t", cameras=("cam0",), version="1", started_ns=START_NS)
        ledger.stopped("empty", {})
    grams = read_totals(path)[-1].sums.as_weighed_g
    for calibrated in (False, True):
        if calibrated:
            ticket = ticket_of(path, run=now, ticket_g=1.1 * grams, ticket_sd_g=5.0)
            write_tickets(tmp_path / "tickets.json", [ticket])
            named = AggregatorConfig(tickets=tmp_path / "tickets.json")
            (tmp_path / "line.toml").write_text(dump_toml(LineConfig(name="t", aggregator=named)))
        with reading(path) as view:
            empty, told = last_loads(view, limit=5)
        assert (told["run"], told["end"], told["final"]) == (now, "stopped", False)
        sums = next(total.sums for total in read_totals(path) if total.label == now)
        figures = (sums.tubers, sums.weight_g, *sums.seen_g, sums.coverage)
        assert tuple(told[name] for name in ("count", "weight_g", "low_g", "high_g", "coverage")) == figures
        assert told["low_g"] < told["weight_g"] < told["high_g"]
        assert (told["weight_g"] > 1.01 * grams) == calibrated
        assert (empty["run"], empty["count"], empty["weight_g"], empty["low_g"]) == ("empty", 0, None, None)


def test_a_run_that_has_ended_is_told_with_the_ticket_that_came_after_it(tmp_path: Path) -> None:
    """The page's earlier runs and `status` told what it came to when its cameras ended, before any ticket."""
    write_run(tmp_path, run="r", crossed_ns=START_NS + np.arange(40) * S, weight_g=np.full(40, 170.0))
    path = tmp_path / "ledger.db"
    with reading(path) as view:
        (before,) = last_loads(view, limit=3)
    write_tickets(tmp_path / "tickets.json", [ticket_of(path, run="r", ticket_g=7500.0, ticket_sd_g=5.0)])
    named = AggregatorConfig(tickets=tmp_path / "tickets.json")
    (tmp_path / "line.toml").write_text(dump_toml(LineConfig(aggregator=named)))
    with reading(path) as view:
        (after,) = last_loads(view, limit=3)
    sums = read_totals(path)[-1].sums
    told = tuple(after[name] for name in ("count", "weight_g", "low_g", "high_g", "coverage"))
    assert told == (40, sums.weight_g, *sums.seen_g, 1.0)
    assert before["weight_g"] == pytest.approx(6800.0)
    assert after["weight_g"] > 7300
    assert (before["final"], after["final"], after["end"]) == (True, True, before["end"])


@pytest.fixture
def lasting(line: tuple[LineConfig, Path]) -> Iterator[tuple[LineConfig, Process]]:
    """A line whose aggregator stays when its cameras have ended."""
    config, path = line
    config = config.model_copy(update={"aggregator": config.aggregator.model_copy(update={"exit_when_final": False})})
    path.write_text(dump_toml(config))
    running = Process(path)
    yield config, running
    if running.popen.poll() is None:
        running.kill()


@pytest.mark.graph
@pytest.mark.timeout(120)
def test_what_is_said_of_loads_after_the_belt_ended_is_in_the_files(lasting: tuple[LineConfig, Process]) -> None:
    """A ticket of the evening, or a load's end, came into the ledger alone."""
    config, process = lasting
    told = tell(14, cameras=2, n=30, length_m=3.0)
    summary, table = config.aggregator.out / "summary.json", config.aggregator.out / "tubers.csv"
    with Node("segmenter", "cam0", config=config, run="story") as node, loader(config) as ask:
        segmenters = Segmenters(node, told)
        wait_until(lambda: segmenters.all_acknowledged(0), what="the first acknowledgement", timeout_s=40)
        assert ask("start", fields={"name": "A"}).done
        segmenters.deliver()
        wait_until(summary.exists, what="the summary of a run whose cameras ended", timeout_s=40)
        (load,) = json.loads(summary.read_text())["loads"]
        assert not load["calibrated_by"]
        grams = load["as_weighed_g"]
        assert ask("ticket", load="A", kg=1.1 * grams / 1000).done

        def calibrated() -> bool:
            return bool(json.loads(summary.read_text())["loads"][0]["calibrated_by"])

        wait_until(calibrated, what="the ticket in summary.json", timeout_s=20)
        with table.open(newline="") as rows:
            assert {row["load"] for row in csv.DictReader(rows)} == {"1"}
        assert ask("undo").done
        process.popen.terminate()
        assert process.end()[0] in (0, -15)
    with table.open(newline="") as rows:
        assert {row["load"] for row in csv.DictReader(rows)} == {"0"}, "the undone start is in the table, too"
