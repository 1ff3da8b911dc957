"""A live line's encoder, as the aggregator hears it: belt before the first frame, cameras that it does not reach."""

from __future__ import annotations

from pathlib import Path

import pytest

from aggregator.core.cameras import Cameras
from aggregator.ledger.writer import Ledger
from conveyor.geometry import Intrinsics
from conveyor.messages import CameraInfo, Travel
from tests.aggregator.belt_story import tell
from tests.aggregator.virtual_line import Aggregator, fresh_run, undisturbed

SECOND_NS = 10**9


def first_word(travel_m: float | None) -> CameraInfo:
    return CameraInfo(
        "a", "r", "streaming", "test", 10.0, False, Intrinsics(10, 10, 10.0, 10.0, 5.0, 5.0), 0.001, 0, 0, 1, {},
        first_captured_ns=50 * SECOND_NS, first_travel_m=travel_m, last_captured_ns=50 * SECOND_NS,
        last_travel_m=travel_m, live=True,
    )  # fmt: skip


@pytest.mark.parametrize(("first_m", "before_m"), [(0.0, 0.0), (1.5, 1.5), (None, None)])
def test_belt_before_the_first_frame_is_known_by_the_encoder(first_m: float | None, before_m: float | None) -> None:
    """Of a line that stood until its first tuber came, 9 s before it were told as belt that was not seen: 53 %."""
    cameras = Cameras(("a",), stall_s=10.0, now_s=91.0)
    cameras.began(91.0)
    cameras.travelled(Travel("belt", "r", 45 * SECOND_NS, 0.0, False))
    cameras.travelled(Travel("belt", "r", 49 * SECOND_NS, 0.1, False))
    cameras.info(first_word(first_m), 100.0)
    assert cameras.sights["a"].published.lead_s == pytest.approx(9.0)
    assert cameras.sights["a"].published.lead_m == before_m


@pytest.mark.parametrize("told_to", ["cam0", "cam1"])
@pytest.mark.parametrize("seed", range(4))
def test_a_camera_that_the_encoder_does_not_reach_is_laid_by_one_that_it_does(
    seed: int, told_to: str, tmp_path: Path
) -> None:
    """Nothing was committed until the load was over, and 19 of 150 tubers counted twice."""
    story = tell(seed, cameras=2, estimated=True, told_to={told_to}, n=25, length_m=2.0, split=0.0)
    with Ledger(tmp_path / "ledger.db") as ledger:
        calm = undisturbed(ledger, story)
        tubers = calm.tubers()
    assert len(tubers) == len(story.tubers)
    assert any(len(tuber.cameras) == 2 for tuber in tubers)
    places = sorted(tuber.place_x_m for tuber in tubers)
    assert places == pytest.approx(sorted(tuber.x_m for tuber in story.tubers), abs=0.02)


def test_tubers_are_committed_while_such_a_line_runs(tmp_path: Path) -> None:
    story = tell(1, cameras=2, estimated=True, told_to={"cam0"}, n=25, length_m=2.0).in_run(fresh_run("run"))
    with Ledger(tmp_path / "ledger.db") as ledger:
        line = Aggregator(ledger, story)
        committed = [len(line.tubers()) for _ in line.commits()]
    assert committed[3 * len(committed) // 4] > len(story.tubers) / 3
