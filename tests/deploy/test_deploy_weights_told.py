"""`tuberline weights list` and `doctor` say where a line weighs with other weights than one thinks."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import zenoh

from aggregator.core.load_sums import LoadSums
from aggregator.core.totals import LoadTotals
from aggregator.ledger.writer import Ledger
from aggregator.queries import Queries
from conveyor import topics
from conveyor.config import LineConfig, LinkConfig
from conveyor.node import Node
from conveyor.observer import Observer
from regressor.serve.messages import WeightsState
from tests.aggregator.loaded_story import story
from tests.aggregator.virtual_line import Aggregator
from tests.conftest import wait_until
from tuberline.cli.address import LineAddress
from tuberline.cli.weights import list_
from tuberline.doctor import Level
from tuberline.doctor.examine import look
from tuberline.doctor.weights import check_running_weights, models_of_run

OLD, NEW = "shipped@11111111", "monday@22222222"


def state(name: str, model: str, *, n: int = 0, refused: str = "") -> WeightsState:
    digest = ("1" if model == OLD else "2") * 64
    return WeightsState(name, "edge", n, digest, model, "", "", refused)


@pytest.mark.parametrize(
    ("states", "models", "level", "said"),
    [
        ([state("r1", OLD), state("r2", OLD)], {OLD: 9, "volume": 1}, Level.OK, f"r1 {OLD}, r2 {OLD}, as their config"),
        ([state("r1", NEW, n=1)], {OLD: 9, NEW: 3}, Level.OK, "given to the running line by order 1"),
        ([state("r1", OLD, n=2)], {OLD: 9, NEW: 3}, Level.OK, "by order 2"),  # rolled back
        ([state("r1", OLD), state("r2", NEW, n=1)], {}, Level.FAULT, "regressors weigh with different weights: r1 "),
        (
            [state("r1", OLD)],
            {OLD: 9, NEW: 3},
            Level.WARNING,
            f"tubers of this run were weighed otherwise (3 with {NEW}): ",
        ),
        ([state("r1", OLD, refused="order 1")], {OLD: 9, NEW: 3}, Level.FAULT, "r1 refuses order 1"),
    ],
)
def test_weights_in_use_are_judged(states: list[WeightsState], models: dict[str, int], level: Level, said: str) -> None:
    (found,) = check_running_weights({state.regressor: state for state in states}, models)
    assert found.level is level
    assert said in found.text
    assert check_running_weights({}, models) == []


@pytest.mark.graph
def test_a_regressor_that_forgot_what_it_was_given_is_told(
    link: LinkConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """After `weights use` the only regressor was killed: it weighed with the old ones, and all was said to be well."""
    with Ledger(tmp_path / "ledger.db") as ledger:
        at_work = Aggregator(ledger, story())
        at_work.commit_one_by_one()
        weighed = ledger.sums("story").load.models()
    totals = LoadTotals(LoadSums(50.0)).message("story", coverage=1.0, cameras={}, final=False)
    config = LineConfig(link=link)
    key = topics.QUERY_MODEL.key("line", regressor="r1")

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(key, state("r1", OLD).encode())

    with (
        Node("aggregator", "aggregator", config=config, run="story") as aggregator,
        Node("regressor", "r1", config=config, run="story") as regressor,
    ):
        regressor.session.declare_queryable(key, zenoh.handlers.Callback(answer, indirect=True))
        with Observer(link, line="line") as observer:
            assert models_of_run(observer) == {}, "no one tells"
            queries = Queries(aggregator, tmp_path / "ledger.db", run="story", totals=totals)
            wait_until(lambda: models_of_run(observer) == weighed, what="the aggregator's answer")
        assert weighed
        list_(address=LineAddress(connect=link.router))
        told = capsys.readouterr().out
        assert f"r1 {OLD}, as their config says, and tubers of this run were weighed otherwise (" in told
        assert "fix: give them again, `tuberline weights use FILE`" in told
        list_(address=LineAddress(connect=link.router), json=True)
        (wrong,) = json.loads(capsys.readouterr().out)["wrong"]
        (found,) = look(config, listen_s=0.2).weights
        assert (found.level, found.text) == (Level.WARNING, wrong)
        del queries
