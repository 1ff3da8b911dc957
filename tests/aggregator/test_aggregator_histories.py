"""Histories under a virtual clock: whatever happens on the way, the ledger ends as if nothing had happened.

Entries of two or three cameras are delayed, reordered and duplicated; the aggregator crashes between and inside its
writes and is rebuilt from the ledger; segmenters vanish for a moment. Hypothesis looks for the shortest story that
breaks a law. `TUBERLINE_HISTORIES` sets how many are told.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

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

from aggregator.core.load_orders import decide
from aggregator.ledger.recount import recounted_spans
from aggregator.ledger.writer import Ledger
from conveyor.messages import LoadOrder
from tests.aggregator.belt_story import tell
from tests.aggregator.virtual_line import Aggregator, fresh_run, undisturbed

HISTORIES = int(os.environ.get("TUBERLINE_HISTORIES", "150"))
_told: dict[tuple[int | str | float, ...], list[str]] = {}


class Crash(Exception):
    """The process dies here."""


class Steps:
    """Counts the ledger's write points down to a crash."""

    def __init__(self) -> None:
        self.left: int | None = None

    def __call__(self, name: str) -> None:
        if self.left is not None:
            self.left -= 1
            if self.left < 0:
                self.left = None
                raise Crash(name)


class Histories(RuleBasedStateMachine):
    """One story, told badly."""

    ledger: Ledger
    steps: Steps

    @initialize(
        seed=st.integers(0, 400),
        cameras=st.integers(2, 3),
        told_to=st.sampled_from(("all", "none", "cam0", "cam1")),
        spread_m=st.sampled_from((0.1, 0.4)),
    )
    def begin(self, seed: int, cameras: int, told_to: str, spread_m: float) -> None:
        """The encoder tells the belt's travel to all cameras, to none, or to one. They hang side by side, or up and
        down the belt.
        """
        told = tell(
            seed, cameras=cameras, estimated=told_to != "all", told_to={told_to}, spread_m=spread_m, n=8, length_m=0.8
        )
        key = (seed, cameras, told_to, spread_m)
        if key not in _told:
            _told[key] = undisturbed(self.ledger, told).canonical()
        self.calm = _told[key]
        self.story = told.in_run(fresh_run("run"))
        self.it = Aggregator(self.ledger, self.story)
        self.sent = dict.fromkeys(self.story.names, 0)
        self.rows: list[tuple[object, ...]] = []

    @rule(camera=st.integers(0, 2), k=st.integers(1, 12))
    def send(self, camera: int, k: int) -> None:
        name = self.story.names[camera % len(self.story.names)]
        for _ in range(k):
            if self.sent[name] < len(self.story.logs[name]):
                self.sent[name] += 1
                self.it.receive(name, self.sent[name])

    @rule(camera=st.integers(0, 2), at=st.integers(0, 60))
    def send_any(self, camera: int, at: int) -> None:
        """An entry from anywhere in the log: far ahead, or long applied."""
        name = self.story.names[camera % len(self.story.names)]
        self.it.receive(name, at % len(self.story.logs[name]) + 1)

    @rule()
    def commit(self) -> None:
        self.it.commit()

    @rule()
    def crash(self) -> None:
        self.it.start()
        self.sent = dict(self.it.acknowledged)

    @rule(at=st.integers(0, 9))
    def crash_while_writing(self, at: int) -> None:
        self.steps.left = at
        try:
            self.it.commit()
        except Crash:
            self.it.start()
            applied = self.it.core.applied()
            assert all(applied[name] >= n for name, n in self.it.acknowledged.items())
            self.sent = dict(self.it.acknowledged)
        self.steps.left = None

    @rule(ahead_m=st.floats(0.0, 0.3), at=st.integers(0, 9))
    def loads_change(self, ahead_m: float, at: int) -> None:
        """A load begins at or ahead of what is committed, and sometimes the process dies on the way; asked again."""
        spans = self.ledger.loads.spans.get(self.story.run, [])
        latest_m = min([self.it.core.watermark_x_m, 0.1, *(span.from_x_m for span in spans)])
        request = f"{self.story.run}-{len(self.ledger.loads.events)}"
        order = LoadOrder(request, "start", place_x_m=latest_m - ahead_m)
        self.steps.left = at
        for _ in range(2):
            event = decide(order, self.ledger.loads, run=self.story.run, now_ns=0, line={}, place_x_m=_stated)
            try:
                self.ledger.say(event)
                break
            except Crash:
                self.it.start()
                self.sent = dict(self.it.acknowledged)
        self.steps.left = None
        assert request in self.ledger.loads.events

    @rule(camera=st.integers(0, 2))
    def segmenter_restarts(self, camera: int) -> None:
        """Its token vanishes for less than it may; it sends again what was not acknowledged."""
        name = self.story.names[camera % len(self.story.names)]
        self.it.core.cameras.presence(name, alive=False, now_s=self.it.now_s)
        self.it.now_s += 0.4
        self.it.core.cameras.presence(name, alive=True, now_s=self.it.now_s)
        self.sent[name] = self.it.acknowledged[name]

    @precondition(lambda self: hasattr(self, "it"))
    @invariant()
    def committed_rows_never_change(self) -> None:
        rows = self.ledger._db.execute(
            "SELECT * FROM tuber WHERE run = ? ORDER BY tuber_id", (self.story.run,)
        ).fetchall()
        assert rows[: len(self.rows)] == self.rows
        self.rows = rows

    @precondition(lambda self: hasattr(self, "it"))
    @invariant()
    def every_applied_track_is_somewhere_once(self) -> None:
        db = self.ledger._db
        (tracks,) = db.execute(
            "SELECT count(*) FROM entry WHERE run = ? AND kind = 'track'", (self.story.run,)
        ).fetchone()
        seen = db.execute("SELECT camera, n FROM observation WHERE run = ?", (self.story.run,)).fetchall()
        assert len(set(seen)) == len(seen) <= tracks

    def teardown(self) -> None:
        if not hasattr(self, "it"):
            return
        self.it.deliver_the_rest()
        assert self.it.core.finished
        assert self.it.canonical() == self.calm
        assert self.it.core.pending == 0
        assert self.it.counts.get("tracks_late", 0) == 0
        self.each_tuber_is_in_the_load_of_its_place()

    def each_tuber_is_in_the_load_of_its_place(self) -> None:
        spans = self.ledger.loads.spans.get(self.story.run, [])
        found = recounted_spans(self.it.tubers(), spans, histogram_step_g=50.0)
        carried = self.ledger.span_sums(self.story.run)
        assert all(found[n].same_as(carried[n].load) for n in found)
        assert sum(sums.count for sums in found.values()) == (len(self.it.tubers()) if spans else 0)


def _stated(order: LoadOrder) -> float:
    assert order.place_x_m is not None
    return order.place_x_m


def test_any_history_ends_in_the_undisturbed_ledger() -> None:
    """Laws 2, 3 and 4 of docs/design.md for the aggregator."""
    folder = Path("/dev/shm") if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=folder) as where:
        steps = Steps()
        with Ledger(Path(where) / "ledger.db", step=steps) as ledger:
            Histories.ledger, Histories.steps = ledger, steps
            run_state_machine_as_test(
                Histories,
                settings=settings(
                    max_examples=HISTORIES,
                    stateful_step_count=25,
                    deadline=None,
                    derandomize="TUBERLINE_HISTORIES" not in os.environ,
                    suppress_health_check=list(HealthCheck),
                    print_blob=True,
                ),
            )


@pytest.mark.parametrize("seed", range(6))
def test_the_undisturbed_ledger_holds_every_tuber_once(seed: int, tmp_path: Path) -> None:
    told = tell(seed, cameras=2 + seed % 2, estimated=seed % 3 == 0, n=25, length_m=2.0)
    with Ledger(tmp_path / "ledger.db") as ledger:
        calm = undisturbed(ledger, told)
        tubers = calm.tubers()
    assert len(tubers) == len(told.seen())
    zero_m = told.cameras[0].zero_m
    for true in told.seen():
        near = [t for t in tubers if abs(t.place_y_m - true.y_m) < 0.02 and abs(t.place_x_m + zero_m - true.x_m) < 0.04]
        assert len(near) == 1, (true, near)
        assert near[0].weight_g == pytest.approx(true.weight_g, rel=0.15)
    assert [t.place_x_m for t in tubers] == sorted((t.place_x_m for t in tubers), reverse=True)
