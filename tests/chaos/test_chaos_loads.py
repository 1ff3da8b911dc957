"""Loads change while a whole line is at work and its processes are killed: every tuber is in the load of its place."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from aggregator.core.loads import span_of
from aggregator.ledger.check import check_file
from aggregator.ledger.load_rows import read_book, read_span_sums
from aggregator.ledger.reader import read_runs, read_sums, read_tubers, reading
from conveyor.load_orders import new_request, send_order
from conveyor.messages import LoadAnswer, LoadOrder
from conveyor.session import open_client
from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay

pytestmark = [pytest.mark.graph, pytest.mark.slow, pytest.mark.timeout(900)]


def test_a_segmenter_and_the_aggregator_killed_around_a_change(recording: Path, run_dir: Path, tmp_path: Path) -> None:
    """The tubers are those of the undisturbed run, each in one load, and the loads add up to the run."""
    answers: list[LoadAnswer] = []

    def disturb(line: DisturbedLine) -> None:
        segmenter = next(name for name in line.supervisor.restarts if name.startswith("segmenter"))
        link = line.observer._link
        with open_client(link, name="loader") as session:

            def ask(action: str, **fields: str) -> None:
                """While the line stays supervised: what was killed is started again."""
                order = LoadOrder(new_request(), action, by="test", fields=fields)  # type: ignore[arg-type]
                with ThreadPoolExecutor(1) as pool:
                    asked = pool.submit(send_order, session, line.observer.line, order, within_s=60)
                    line.wait(asked.done, what=f"an answer to {action} {fields}", timeout_s=90)
                answers.append(asked.result())

            line.wait_count("frames_processed", 10)
            ask("start", name="A")
            line.kill(segmenter)
            ask("start", name="B")
            line.kill("aggregator")
            ask("start", name="C")
            line.kill(segmenter)

    summary = disturbed_replay(recording, tmp_path / "run", disturb, speed=0.1, timeout_s=300)
    assert summary["balanced"]
    assert [answer.error for answer in answers] == ["", "", ""]
    assert canonical(tmp_path / "run") == canonical(run_dir)
    path = tmp_path / "run" / "ledger.db"
    assert check_file(path) == []
    with reading(path) as view:
        (run,) = read_runs(view)
        spans, sums = read_book(view).spans[run.run], read_span_sums(view, run.run)
        found = dict.fromkeys((span.n for span in spans), 0)
        for tuber in read_tubers(view, run.run):
            found[span_of(spans, tuber.place_x_m).n] += 1
        assert {n: sums[n].load.count for n in found} == found
        assert sum(found.values()) == read_sums(view, run.run).load.count
    assert [span.load for span in spans] == [0, 1, 2, 3]
