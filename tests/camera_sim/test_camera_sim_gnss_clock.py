"""A host's clock is set while its receiver tells positions: they go on by the time that they had, as tubers do."""

from __future__ import annotations

import re
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import pytest

from camera_sim.day_clock import AT_ONCE_NS, DayClock
from conveyor.config import LineConfig, LinkConfig
from conveyor.formats.positions import COLUMNS, POSITIONS_FILE
from tests.camera_sim.camera_process import process
from tests.chaos.test_chaos_hosts import COMPILER, Clock
from tests.conftest import wait_until

S = 10**9
HOUR_NS = 3600 * S


class Clocks:
    """A wall clock that is set by hand and a steady one."""

    def __init__(self) -> None:
        self.steady_ns, self.ahead_ns, self.pauses_ns = 50 * S, 10**18, [0]

    def wall(self) -> int:
        self.steady_ns += self.pauses_ns.pop() if self.pauses_ns else 0
        return self.steady_ns + self.ahead_ns

    def steady(self) -> int:
        return self.steady_ns


def test_steps_are_left_out_and_told_once() -> None:
    clocks = Clocks()
    clock = DayClock(wall_ns=clocks.wall, steady_ns=clocks.steady)
    began_ns = clocks.wall()
    for passed_s, step_ns in ((1, 0), (2, HOUR_NS), (3, 0), (4, -24 * HOUR_NS), (5, -2 * S), (6, 0)):
        clocks.steady_ns += S
        clocks.ahead_ns += step_ns
        assert clock.now() == (began_ns + passed_s * S, step_ns)
    clocks.ahead_ns += S // 10
    assert clock.now() == (began_ns + 6 * S + S // 10, 0), "a clock that is slewed is followed"


def test_a_pause_between_two_looks_is_no_step() -> None:
    clocks = Clocks()
    clock = DayClock(wall_ns=clocks.wall, steady_ns=clocks.steady)
    began_ns = clocks.wall()
    clocks.pauses_ns = [0, 5 * S]
    assert clock.now() == (began_ns + 5 * S, 0)
    clocks.pauses_ns = [AT_ONCE_NS - 1]
    time_ns, step_ns = clock.now()
    assert (time_ns - began_ns - 5 * S, step_ns) == (AT_ONCE_NS - 1, 0)


@pytest.mark.graph
@pytest.mark.timeout(120)
@pytest.mark.skipif(COMPILER is None, reason="a clock is faked by a library of a few lines: it needs a C compiler")
def test_positions_of_a_real_process_go_on_over_a_step(link: LinkConfig, tmp_path: Path) -> None:
    """After an hour's step the map looked for each tuber where the machine had been an hour before."""
    config = LineConfig.model_validate(
        {"link": link, "gnss": {"source": "simulated:"}, "aggregator": {"out": str(tmp_path / "out")}}
    )
    file = tmp_path / "out" / POSITIONS_FILE

    def times_s() -> list[float]:
        rows = file.read_text().splitlines()[1:] if file.is_file() else []
        return [int(row.split(",")[COLUMNS.index("time_ns")]) / S for row in rows if row.count(",") == len(COLUMNS) - 1]

    clock = Clock(tmp_path, ahead_s=0.0)
    with ExitStack() as stack:
        with clock:
            gnss = stack.enter_context(process(config, tmp_path, "gnss"))
        wait_until(lambda: len(times_s()) >= 3, what="positions")
        clock.set(3600.0)
        before = len(times_s())
        wait_until(lambda: len(times_s()) >= before + 5, what="positions after the step")
        gnss.terminate()
        said = gnss.communicate(timeout=30)[1]
    times = times_s()
    assert max(later - earlier for earlier, later in pairwise(times)) < 600
    assert [round(float(s)) for s in re.findall(r"clock was set by (\S+) s", said)] == [3600]
