"""Capture times of a live camera whose clock steps, slews, or stands: laws, without processes."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conveyor.camera_clock import STEP_NS, CameraClock
from segmenter.age import FrameAge

PERIOD_NS = 33_000_000
EPOCH_NS = 1_760_000_000_000_000_000
HOUR_NS = 3600 * 10**9


def times(
    steps: dict[int, int], frames: int = 200, *, lost: frozenset[int] = frozenset(), late: dict[int, int] | None = None
) -> list[tuple[int, int, int]]:
    """(steady time, step, age in ns) of each frame; `steps`: by how much the clock is ahead from a frame on."""
    clock, age, ahead_ns, found = CameraClock(), FrameAge(), 0, []
    for seq in range(frames):
        ahead_ns = steps.get(seq, ahead_ns)
        if seq in lost:
            continue
        arrived_ns = seq * PERIOD_NS + (late or {}).get(seq, 0)
        steady_ns, step_ns = clock.steady_ns(seq, EPOCH_NS + seq * PERIOD_NS + ahead_ns, arrived_ns)
        found.append((steady_ns, step_ns, round(age.age_ms(steady_ns, arrived_ns) * 1e6)))
    return found


@pytest.mark.parametrize("step_ns", [-2 * 10**9, 2 * 10**9, -HOUR_NS, HOUR_NS, -24 * HOUR_NS, -100_000_000])
def test_a_step_is_told_once_and_time_goes_on(step_ns: int) -> None:
    """A clock 2 s back made 299 of the next 300 frames too old."""
    found = times({100: step_ns})
    assert [steady_ns for steady_ns, _, _ in found] == [EPOCH_NS + seq * PERIOD_NS for seq in range(200)]
    assert {seq: step for seq, (_, step, _) in enumerate(found) if step} == {100: step_ns}
    assert max(age_ns for _, _, age_ns in found) == 0


@given(
    st.dictionaries(st.integers(1, 199), st.integers(-3 * HOUR_NS, 3 * HOUR_NS), max_size=5),
    st.sets(st.integers(1, 198), max_size=60),
)
def test_times_only_go_forward_and_no_frame_is_called_old(steps: dict[int, int], lost: set[int]) -> None:
    found = times(steps, lost=frozenset(lost))
    steady = [steady_ns for steady_ns, _, _ in found]
    assert all(b > a for a, b in pairwise(steady))
    assert max(age_ns for _, _, age_ns in found) <= len(steps) * STEP_NS


def test_a_frame_that_waited_is_late_and_no_step() -> None:
    late = {seq: (120 - seq) * PERIOD_NS for seq in range(100, 120)}  # a receiver that stood still for 0.66 s
    found = times({}, late=late)
    assert not any(step for _, step, _ in found)
    assert found[100][2] == 20 * PERIOD_NS
    assert found[150][2] == 0


def test_a_camera_that_paused_and_one_that_slews_do_not_step() -> None:
    clock = CameraClock()
    for seq in range(50):
        assert clock.steady_ns(seq, EPOCH_NS + seq * PERIOD_NS, seq * PERIOD_NS)[1] == 0
    pause_ns = 10 * 10**9
    for seq in range(50, 3000):  # 500 ppm, as NTP slews
        captured_ns = EPOCH_NS + seq * PERIOD_NS + pause_ns + (seq - 50) * 16_500
        assert clock.steady_ns(seq, captured_ns, seq * PERIOD_NS + pause_ns) == (captured_ns, 0)


def test_a_camera_that_stood_still_while_its_clock_stepped_is_not_late_for_ever() -> None:
    clock, age = CameraClock(), FrameAge()
    ages = []
    for seq in range(100):
        stood_ns, ahead_ns = (4 * 10**9, HOUR_NS) if seq >= 50 else (0, 0)
        arrived_ns = seq * PERIOD_NS + stood_ns
        steady_ns, _ = clock.steady_ns(seq, EPOCH_NS + seq * PERIOD_NS + ahead_ns, arrived_ns)
        ages.append(age.age_ms(steady_ns, arrived_ns))
    assert max(ages) < 1.0


def test_a_process_that_starts_again_goes_on_behind_the_one_before() -> None:
    clock = CameraClock(floor_ns=EPOCH_NS + HOUR_NS)
    steady_ns, step_ns = clock.steady_ns(500, EPOCH_NS, 0)
    assert step_ns < 0
    assert EPOCH_NS + HOUR_NS < steady_ns < EPOCH_NS + HOUR_NS + 10**9
    assert CameraClock(floor_ns=EPOCH_NS).steady_ns(500, EPOCH_NS + HOUR_NS, 0) == (EPOCH_NS + HOUR_NS, 0)


@pytest.mark.parametrize("fps", [5, 15, 30, 90])
def test_a_gap_before_the_rate_is_known_is_no_step(fps: int) -> None:
    """At 15 frames a second, played faster than the line took them, the 196th frame after the first was 4.8 s back."""
    clock = CameraClock(5.0)
    period_ns = 10**9 // fps
    assert clock.steady_ns(0, 10**15, 0) == (10**15, 0)
    assert clock.steady_ns(196, 10**15 + 196 * period_ns, 60 * 10**9) == (10**15 + 196 * period_ns, 0)
    assert clock.steady_ns(197, 10**15 + 197 * period_ns, 60 * 10**9 + period_ns)[1] == 0
