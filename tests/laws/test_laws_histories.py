"""Whatever happens between the processes, the ledger ends as if nothing had: laws 1 to 4 over the whole graph.

Hypothesis looks for the shortest story that breaks one. `TUBERLINE_HISTORIES` sets how many are told, in which case
they are new ones each time and the seed is printed.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    rule,
    run_state_machine_as_test,
)

from aggregator.ledger.schema import TUBER
from tests.laws.virtual_graph import FRAMES, NAMES, REGRESSORS, Graph, true_places

HISTORIES = int(os.environ.get("TUBERLINE_HISTORIES", "40"))
MOST_TURNS = 4000
TURNS = st.integers(0, 10)
"""Of 40 ms, after each event: twelve events fall into the 50 turns that an undisturbed line takes, or just after."""
_calm: list[list[str]] = []


def memory_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder in memory where there is one: a history writes hundreds of small files through to the disk."""
    return tempfile.TemporaryDirectory(dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None)


def run_out(graph: Graph) -> None:
    """Until everything is counted."""
    for _ in range(MOST_TURNS):
        if graph.finished:
            return
        graph.turn()
    pytest.fail(f"not finished after {MOST_TURNS} turns: {graph.audit().as_dict()}")


def calm() -> list[str]:
    """The ledger of the line when nothing happens."""
    if not _calm:
        with memory_folder() as folder:
            graph = Graph(Path(folder), 0)
            run_out(graph)
            _calm.append(graph.canonical())
            graph.close()
    return _calm[0]


class Histories(RuleBasedStateMachine):
    """A line at work to which things happen."""

    @initialize(seed=st.integers(0, 1 << 20), window=st.sampled_from([1, 1, 4]))
    def begin(self, seed: int, window: int) -> None:
        self.folder = memory_folder()
        self.graph = Graph(Path(self.folder.name), seed, window=window)
        self.rows: list[tuple[object, ...]] = []

    def work(self, turns: int) -> None:
        for _ in range(turns):
            self.graph.turn()

    @rule(turns=TURNS)
    def nothing_happens(self, turns: int) -> None:
        self.work(turns)

    @rule(
        drop=st.sampled_from([0.0, 0.1, 0.4]),
        twice=st.sampled_from([0.0, 0.3]),
        delay=st.sampled_from([0, 0.1, 1, 3]),
        turns=TURNS,
    )
    def links_turn_bad(self, drop: float, twice: float, delay: float, turns: int) -> None:
        faults = self.graph.faults
        faults.drop, faults.duplicate, faults.delay_s = drop, twice, delay
        self.work(turns)

    @rule(turns=TURNS)
    def router_goes_or_comes(self, turns: int) -> None:
        self.graph.faults.cut = not self.graph.faults.cut
        self.work(turns)

    @rule(name=st.sampled_from([*NAMES, *REGRESSORS, "aggregator"]), writes=st.integers(0, 12), turns=TURNS)
    def somebody_dies_between_two_writes(self, name: str, writes: int, turns: int) -> None:
        self.graph.fuses[name].left = writes
        self.work(turns)

    @rule(name=st.sampled_from(NAMES), turns=TURNS)
    def segmenter_dies(self, name: str, turns: int) -> None:
        self.graph.kill_segmenter(name)
        self.work(turns)

    @rule(name=st.sampled_from(NAMES), turns=TURNS)
    def camera_dies(self, name: str, turns: int) -> None:
        self.graph.kill_camera(name)
        self.work(turns)

    @rule(name=st.sampled_from(REGRESSORS), turns=TURNS)
    def regressor_dies(self, name: str, turns: int) -> None:
        self.graph.kill_regressor(name)
        self.work(turns)

    @rule(name=st.sampled_from(REGRESSORS), seconds=st.sampled_from([0.5, 3.0]), turns=TURNS)
    def regressor_freezes(self, name: str, seconds: float, turns: int) -> None:
        self.graph.freeze_regressor(name, seconds)
        self.work(turns)

    @rule(turns=TURNS)
    def aggregator_dies(self, turns: int) -> None:
        self.graph.kill_aggregator()
        self.work(turns)

    @invariant()
    def committed_tubers_never_change(self) -> None:
        rows = self.graph.tubers()
        assert rows[: len(self.rows)] == self.rows
        self.rows = rows

    @invariant()
    def sheets_balance_at_every_moment(self) -> None:
        for run in self.graph.segmenters.values():
            if run is None:
                continue
            sheets = run.counts()
            frames, views, tracks = sheets["frames"], sheets["views"], sheets["tracks"]
            assert frames["published"] == frames["received"] + frames["gaps"]
            assert frames["received"] == frames["processed"]
            lost = sum(n for key, n in views.items() if key.startswith("lost_"))
            assert views["sent"] == views["weighed"] + views["outstanding"] + lost
            gone = sum(n for key, n in tracks.items() if key.startswith("discarded_"))
            assert tracks["opened"] == tracks["counted"] + tracks["open"] + gone
            assert tracks["counted"] >= 0 <= tracks["open"]

    def teardown(self) -> None:
        if not hasattr(self, "graph"):
            return
        faults = self.graph.faults
        faults.drop, faults.duplicate, faults.delay_s, faults.cut = 0.0, 0.0, 0.0, False
        try:
            run_out(self.graph)
            assert self.graph.canonical() == calm()
            assert self.graph.audit().balanced, self.graph.audit().as_dict()
            assert self.graph.lost.get("tracks_late", 0) == 0
        finally:
            self.graph.close()
            self.folder.cleanup()


def test_any_history_ends_in_the_undisturbed_ledger() -> None:
    calm()
    run_state_machine_as_test(
        Histories,
        settings=settings(
            max_examples=HISTORIES,
            stateful_step_count=12,
            deadline=None,
            derandomize="TUBERLINE_HISTORIES" not in os.environ,
            suppress_health_check=list(HealthCheck),
            print_blob=True,
        ),
    )


def test_the_undisturbed_ledger_holds_every_tuber_once() -> None:
    with memory_folder() as folder:
        graph = Graph(Path(folder), 0)
        run_out(graph)
        audit = graph.audit()
        places = np.array([row[3:5] for row in graph.ledger.view.rows(TUBER)], np.float64)
        graph.close()
    assert audit.balanced
    for name in NAMES:
        mark = audit.marks[name]
        assert mark is not None
        assert mark.frames["processed"] == mark.frames["published"] == FRAMES
    away_m = np.hypot(*(true_places()[:, None] - places[None]).transpose(2, 0, 1))
    assert len(places) == len(true_places())
    assert away_m.min(axis=1).max() < 0.01
