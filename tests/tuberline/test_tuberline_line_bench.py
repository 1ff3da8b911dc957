"""The benchmarks of a line: hops add up, percentiles are values seen, what an aggregator takes is what it took."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.aggregate import blocks
from benchmarks.line_table import markdown
from benchmarks.line_virtual import LosingQueue, LosingWorker, shipped, waits_s
from benchmarks.line_watch import HOPS, TOTAL, Stamps, latencies_s, percentile
from conveyor.messages import TrackEntry, Tuber
from conveyor.reasons import Requeue
from tests.laws.virtual_overload import _TRACK, FloodedLine

S = 1_000_000_000


def tuber(*tracks: str) -> Tuber:
    return Tuber(
        1, "r", 0, 0.0, 0.0, 100.0, 90.0, 110.0, 60.0, 50.0, 40.0, 1, "pointraft", "m", (), ("left", "right"), tracks
    )


def logged(stamps: Stamps, track_id: str, *, crossed_s: float, at_s: float) -> None:
    track = replace(_TRACK, track_id=track_id, crossed_ns=round(crossed_s * S))
    camera = track_id.split("/")[1]
    stamps.entry(TrackEntry(camera=camera, run="r", n=1, track=track, mark=None), round(at_s * S))


@pytest.fixture
def stamps() -> Stamps:
    """The left camera's row was crossed at 102 s, the right one's at 103 s; each was logged 0.5 s later."""
    found = Stamps()
    for camera, crossed_s in (("left", 102.0), ("right", 103.0)):
        at_s = crossed_s + 0.5
        track_id = f"r/{camera}/0-1"
        found.sent_ns[track_id] = round((at_s - 0.3) * S)
        found.answered_ns[track_id] = round((at_s - 0.2) * S)
        logged(found, track_id, crossed_s=crossed_s, at_s=at_s)
    return found


def test_the_hops_of_the_track_logged_last_add_up_to_the_whole(stamps: Stamps) -> None:
    stamps.tuber(tuber("r/left/0-1", "r/right/0-1"), 104 * S)
    found = latencies_s(stamps, from_ns=0)
    assert {hop: pytest.approx(values) for hop, values in found.items()} == {
        "view sent": [0.2], "first answer": [0.1], "logged": [0.2], "committed": [0.5], TOTAL: [1.0],
    }  # fmt: skip
    assert sum(found[hop][0] for hop in HOPS) == pytest.approx(found[TOTAL][0])


def test_what_was_committed_before_or_never_weighed_is_left_out(stamps: Stamps) -> None:
    stamps.tuber(tuber("r/left/0-1"), 103 * S)
    logged(stamps, "r/left/0-2", crossed_s=102.5, at_s=103.0)
    stamps.tuber(tuber("r/left/0-2"), 105 * S)
    assert latencies_s(stamps, from_ns=104 * S)[TOTAL] == []
    assert len(latencies_s(stamps, from_ns=0)[TOTAL]) == 1


@given(values=st.lists(st.floats(0, 100), min_size=1), share=st.floats(0.01, 1.0))
def test_a_percentile_is_a_value_that_was_seen(values: list[float], share: float) -> None:
    found = percentile(values, share)
    assert found in values
    assert sum(value <= found for value in values) >= share * len(values) - 1e-9


def test_the_table_names_every_loss() -> None:
    books = {"frames_published": 100.0, "frames_processed": 90.0, "frames_dropped_overwritten": 10.0,
             "views_sent": 30.0, "views_weighed": 20.0, "views_lost_late": 10.0, "views_per_tuber": 2.0,
             "views_weighed_per_track": 2.0, "regressors_busy_share": 0.5}  # fmt: skip
    text = markdown(
        {
            "asked": {"cameras": 1, "fps": 15.0, "tubers_per_s": 20.0, "regressors": 2, "precision": "float32",
                      "centroids": None, "seed": 11, "seconds": 60.0, "load": "even", "tubers": 400},
            "machine": {"cores": 2, "machine": "x86_64", "python": "3.11"},
            "load_average": (1.0, 2.0),
            "tubers_per_s": 19.6,
            "cpu_percent": 140.0,
            "processes": {"router": {"cpu_percent": 140.0, "memory_mib": 10.0, "restarts": 0}},
            "segmenters": {"segmenter/left": books},
            "latency": {TOTAL: {"p50_s": 0.5, "p99_s": 0.9, "n": 1200}},
        }
    )  # fmt: skip
    assert "| router | 140 | 10 | 0 |" in text
    assert "| crossing to ledger | 0.50 | 0.90 | 1200 |" in text
    assert (
        "frames 90 of 100 processed, frames_dropped_overwritten 10, views_lost_late 10, views weighed 20 of 30" in text
    )


@pytest.mark.parametrize("lost", [0.0, 0.01, 0.05])
def test_shipped_settings_let_a_tuber_be_committed_within_a_second_of_the_virtual_clock(lost: float) -> None:
    """One lost view in a hundred made it 4.7 s (p50), 6.9 s (p99): missed after 5 s, it held all others up."""
    line = FloodedLine(per_s=20.0, takes_s=0.012, workers=2, turn_s=1 / 15, settings=shipped())
    line.crew = {f"w{n}": LosingWorker(0.012, link=LosingQueue(lost, n)) for n in range(2)}
    found = waits_s(line, seconds=60.0)
    assert len(found) > 1100
    assert percentile(found, 0.99) < 1.0
    assert not line.never_weighed
    assert len(line.logged) == len({track.track_id for track in line.logged})
    arrived = line.run.dispatcher.requeued[Requeue.LOST_ON_THE_WAY] + line.run.dispatcher.requeued[Requeue.DEADLINE]
    lost_views = sum(worker.link.lost for worker in line.crew.values())  # type: ignore[attr-defined]
    given_up = line.lost.get("late", 0)  # a spare view may be too late before it is missed
    assert lost_views - 4 <= arrived + given_up, "a lost view was never missed"
    assert (lost_views > 0) == (lost > 0)


def test_what_an_aggregator_takes_is_told_of_the_tubers_that_it_took(tmp_path: Path) -> None:
    """A tenth of few tubers is less than a commit, by which the time of a whole commit was divided."""
    begun = time.perf_counter()
    found = blocks(tmp_path, 120, per_s=1000.0)
    took_ms = 1e3 * (time.perf_counter() - begun)
    assert [block.tubers for block in found] == [50, 100, 120]
    assert sum(n * block.wall_ms for n, block in zip((50, 50, 20), found, strict=True)) < took_ms
