"""An aggregation and its ledger under a clock of ours, as the node ties them together."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

from aggregator.core.camera_log import Taken
from aggregator.core.machine import Aggregation
from aggregator.ledger.export import canonical_lines
from aggregator.ledger.writer import Ledger
from conveyor.messages import Tuber
from tests.aggregator.belt_story import Story

STALL_S = 10.0
_runs = count()


def fresh_run(prefix: str) -> str:
    """A run id that no ledger of this test session holds."""
    return f"{prefix}{next(_runs)}"


class Aggregator:
    """An aggregation and its ledger, as the node ties them together; the clock is ours. `line`: what it is called."""

    line = "t"

    def __init__(self, ledger: Ledger, story: Story, *, reach_mm: float | None = None) -> None:
        self.ledger = ledger
        self.reach_mm = reach_mm
        self.story = story
        self.now_s = 0.0
        self.acknowledged = dict.fromkeys(story.names, 0)
        self.counts: dict[str, int] = {}
        self.start()

    def start(self) -> None:
        """Begin, or begin again from the ledger alone."""
        restored = self.ledger.open_run(
            self.story.run, line=self.line, cameras=self.story.names, version="1", started_ns=0, may_be_finished=True
        )
        self.core = Aggregation(
            self.story.run,
            cameras=self.story.names,
            merge_gate_mm=30,
            camera_stall_s=STALL_S,
            committed=self.ledger.committed(self.story.run),
            now_s=self.now_s,
            restored=restored,
            reach_mm=self.reach_mm,
            count=lambda name: self.counts.update({name: self.counts.get(name, 0) + 1}),
        )

    def commit(self) -> None:
        self.now_s += 0.2
        batch = self.core.commit(now_s=self.now_s)
        if not batch.empty:
            self.ledger.write(self.story.run, batch)
        self.acknowledged = self.core.applied()

    def receive(self, camera: str, n: int) -> Taken:
        return self.core.receive(self.story.logs[camera][n - 1], now_s=self.now_s)

    def commits(self) -> Iterator[int]:
        """Entry n of every camera, then a commit; yields n after each."""
        for n in range(1, max(len(log) for log in self.story.logs.values()) + 1):
            for camera in self.story.names:
                if n <= len(self.story.logs[camera]):
                    self.receive(camera, n)
            self.commit()
            yield n

    def commit_one_by_one(self) -> None:
        """All of `commits`."""
        for _ in self.commits():
            pass

    def deliver_the_rest(self) -> None:
        """Segmenters send again what is not acknowledged, until all is."""
        for camera, log in self.story.logs.items():
            for n in range(self.acknowledged[camera] + 1, len(log) + 1):
                self.receive(camera, n)
        self.commit()

    def tubers(self) -> list[Tuber]:
        return list(self.ledger.tubers(self.story.run))

    def canonical(self) -> list[str]:
        row = self.ledger.run_row(self.story.run)
        assert row is not None
        return list(canonical_lines(self.ledger.view, row))


def undisturbed(ledger: Ledger, told: Story) -> Aggregator:
    """The story as it should go: everything arrives in order, the cameras side by side."""
    story = told.in_run(fresh_run("calm"))
    aggregator = Aggregator(ledger, story)
    aggregator.commit_one_by_one()
    assert aggregator.core.finished
    return aggregator
