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
    precondition,
    rule,
    run_state_machine_as_test,
)

from tests.laws.virtual_graph import FRAMES, NAMES, REGRESSORS, Graph, true_places

HISTORIES = int(os.environ.get("TUBERLINE_HISTORIES", "40"))
MOST_TURNS = 4000
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

    @initialize(seed=st.integers(0, 1 << 20))
    def begin(self, seed: int) -> None:
        self.folder = memory_folder()
        self.graph = Graph(Path(self.folder.name), seed)
        self.rows: list[tuple[object, ...]] = []

    @rule(turns=st.integers(1, 40))
    def work(self, turns: int) -> None:
        for _ in range(turns):
            self.graph.turn()

    @rule(drop=st.sampled_from([0.0, 0.1, 0.4]), twice=st.sampled_from([0.0, 0.3]), delay=st.sampled_from([0, 0.1, 1]))
    def links_turn_bad(self, drop: float, twice: float, delay: float) -> None:
        faults = self.graph.faults
        faults.drop, faults.duplicate, faults.delay_s = drop, twice, delay

    @rule()
    def router_goes_or_comes(self) -> None:
        self.graph.faults.cut = not self.graph.faults.cut

    @rule(name=st.sampled_from(NAMES))
    def segmenter_dies(self, name: str) -> None:
        self.graph.kill_segmenter(name)

    @rule(name=st.sampled_from(NAMES))
    def camera_dies(self, name: str) -> None:
        self.graph.kill_camera(name)

    @rule(name=st.sampled_from(REGRESSORS))
    def regressor_dies(self, name: str) -> None:
        self.graph.kill_regressor(name)

    @rule(name=st.sampled_from(REGRESSORS), seconds=st.sampled_from([0.5, 3.0]))
    def regressor_freezes(self, name: str, seconds: float) -> None:
        self.graph.freeze_regressor(name, seconds)

    @rule()
    def aggregator_dies(self) -> None:
        self.graph.kill_aggregator()

    @precondition(lambda self: hasattr(self, "graph"))
    @invariant()
    def committed_tubers_never_change(self) -> None:
        rows = self.graph.tubers()
        assert rows[: len(self.rows)] == self.rows
        self.rows = rows

    @precondition(lambda self: hasattr(self, "graph"))
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
        places = np.array(
            graph.ledger.connection.execute("SELECT place_x_m, place_y_m FROM tuber").fetchall(), np.float64
        )
        graph.close()
    assert audit.balanced
    for name in NAMES:
        mark = audit.marks[name]
        assert mark is not None
        assert mark.frames["processed"] == mark.frames["published"] == FRAMES
    away_m = np.hypot(*(true_places()[:, None] - places[None]).transpose(2, 0, 1))
    assert len(places) == len(true_places())
    assert away_m.min(axis=1).max() < 0.01
