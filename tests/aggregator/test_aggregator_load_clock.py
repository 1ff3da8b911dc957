"""The clock of the aggregator's machine is set while a load is open: what was done a moment ago can be undone."""

from __future__ import annotations

from pathlib import Path

import pytest

from conveyor.config import LineConfig
from conveyor.load_orders import give_order
from conveyor.messages import LoadOrder
from tests.aggregator.test_aggregator_node import Process, line
from tests.chaos.test_chaos_hosts import COMPILER, Clock

__all__ = ["line"]
pytestmark = [
    pytest.mark.graph,
    pytest.mark.timeout(120),
    pytest.mark.skipif(COMPILER is None, reason="a clock is faked by a library of a few lines: it needs a C compiler"),
]


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_a_start_is_undone_though_the_clock_was_set_by_an_hour(
    step_s: float, line: tuple[LineConfig, Path], tmp_path: Path
) -> None:
    config, path = line
    clock = Clock(tmp_path, ahead_s=0.0)
    with clock:
        process = Process(path)
    try:
        begun = give_order(config.link, "t", LoadOrder("a", "start", fields={"name": "A"}), within_s=60)
        assert begun.done
        clock.set(step_s)
        undone = give_order(config.link, "t", LoadOrder("u", "undo"), within_s=60)
        assert (undone.error, undone.text) == ("", "the start of load 1 (A) is undone: no load is open")
    finally:
        process.kill()
