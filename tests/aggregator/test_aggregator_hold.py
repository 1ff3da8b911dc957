"""What a waiting order about a load holds back: tubers beyond the place where the load is to change."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from aggregator.ledger.writer import Ledger
from tests.aggregator.belt_story import tell
from tests.aggregator.virtual_line import Aggregator, undisturbed


@pytest.mark.parametrize("hold_at_x_m", [math.inf, -0.5, -1.0])
def test_nothing_beyond_the_change_is_committed_until_it_is_made(tmp_path: Path, hold_at_x_m: float) -> None:
    """All of the belt came at once, as after a restart: nothing of it was left for the load that had begun on it."""
    told = tell(11, n=30, cameras=2)
    with Ledger(tmp_path / "calm.db") as ledger:
        calm = undisturbed(ledger, told).canonical()
    with Ledger(tmp_path / "ledger.db") as ledger:
        it = Aggregator(ledger, told)
        for camera, log in told.logs.items():
            for n in range(1, len(log) + 1):
                it.receive(camera, n)
        batch = it.core.commit(now_s=it.now_s, hold_at_x_m=hold_at_x_m)
        assert it.core.watermark_x_m == hold_at_x_m
        assert all(tuber.place_x_m >= hold_at_x_m for tuber in batch.tubers)
        assert any(tuber.x_m < hold_at_x_m for tuber in told.seen())
        ledger.write(told.run, batch)
        it.commit()
        assert it.core.finished
        assert it.canonical() == calm
