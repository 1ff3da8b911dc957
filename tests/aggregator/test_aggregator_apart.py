"""Cameras that put the same tubers at different places: told with how far, and how many were counted twice."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from aggregator.ledger.apart import cameras_apart
from aggregator.ledger.reader import reading
from aggregator.ledger.writer import Ledger
from aggregator.ledger.zeros import zeros_told
from conveyor.apart import apart_in_words, apart_told
from conveyor.messages import CamerasApart, Track
from tests.aggregator.belt_story import Story, tell
from tests.aggregator.virtual_line import Aggregator

TUBERS, BELT_M = 130, 9.0


def moved(story: Story, camera: str, *, along_mm: float = 0.0, across_mm: float = 0.0) -> Story:
    """A camera that says of each tuber that it lies so much farther."""

    def shifted(track: Track) -> Track:
        return replace(track, crossed_x_m=track.crossed_x_m + along_mm / 1000, y_m=track.y_m + across_mm / 1000)

    log = [replace(e, track=shifted(e.track)) if e.track else e for e in story.logs[camera]]
    return replace(story, logs={**story.logs, camera: log})


def counted(path: Path, story: Story) -> tuple[Aggregator, tuple[CamerasApart, ...]]:
    path.mkdir(exist_ok=True)
    with Ledger(path / "ledger.db") as ledger:
        line = Aggregator(ledger, story)
        line.commit_one_by_one()
        line.deliver_the_rest()
        found = cameras_apart(ledger.view, story.run, story.names, gate_mm=30.0)
        line.counts["ledger"] = len(line.tubers())
        return line, found


@pytest.mark.parametrize("seed", [21, 22, 23])
def test_cameras_that_agree_are_told_so(tmp_path: Path, seed: int) -> None:
    story = tell(seed, n=TUBERS, length_m=BELT_M, noise_mm=1.5, split=0.0)
    line, (apart,) = counted(tmp_path, story)
    assert line.counts["ledger"] == len(story.seen())
    assert (apart.first, apart.second, apart.twice, apart.alarm) == ("cam0", "cam1", 0, False)
    assert (apart.along_mm, apart.across_mm) == pytest.approx((0, 0), abs=2)
    assert apart.shared >= 0.8 * sum(abs(t.y_m) <= 0.08 for t in story.tubers)
    assert apart_in_words((apart,)) == ""


@pytest.mark.parametrize(("along_mm", "across_mm"), [(0, 45), (-60, 0), (25, 300), (-20, -594), (600, 0), (-1800, 20)])
def test_a_camera_that_hangs_elsewhere_counts_twice_and_that_is_told(
    tmp_path: Path, along_mm: float, across_mm: float
) -> None:
    story = tell(24, n=TUBERS, length_m=BELT_M, noise_mm=1.5, split=0.0)
    line, (apart,) = counted(tmp_path, moved(story, "cam1", along_mm=along_mm, across_mm=across_mm))
    assert (apart.along_mm, apart.across_mm) == pytest.approx((along_mm, across_mm), abs=2)
    assert apart.alarm
    twice = line.counts["ledger"] - len(story.seen())
    assert apart.twice == apart.shared
    if abs(across_mm) < 100:  # farther off, tubers beside each other are taken for one
        assert 0.7 * twice <= apart.twice <= twice + 2
    said = apart_in_words((apart,))
    assert f"cameras cam0 and cam1 put the same tubers {abs(along_mm):.0f} mm apart" in said.replace("59 mm", "60 mm")
    assert f"{apart.twice} of {apart.shared} counted twice" in said
    assert "calibrate cameras" in said


def test_half_of_the_gate_is_told_before_anything_counts_twice(tmp_path: Path) -> None:
    story = tell(25, n=TUBERS, length_m=BELT_M, noise_mm=1.5, split=0.0)
    line, (apart,) = counted(tmp_path, moved(story, "cam1", across_mm=19))
    assert line.counts["ledger"] == len(story.seen())
    assert (apart.twice, apart.alarm) == (0, True)
    assert "none counted twice yet" in apart_told(apart)


def test_one_camera_and_cameras_that_share_no_tuber_are_silent(tmp_path: Path) -> None:
    _, found = counted(tmp_path, tell(26, n=TUBERS, length_m=BELT_M, cameras=1))
    assert found == ()
    story = tell(27, n=TUBERS, length_m=BELT_M, split=0.0)
    parted = {
        name: [replace(e, track=None) if e.track and abs(e.track.y_m) < 0.1 else e for e in log]
        for name, log in story.logs.items()
    }
    logs = {name: [e for e in log if e.track or e.mark] for name, log in parted.items()}
    logs = {name: [replace(e, n=n) for n, e in enumerate(log, start=1)] for name, log in logs.items()}
    _, found = counted(tmp_path / "b", replace(story, logs=logs))
    assert found == ()


def test_travel_that_counts_from_another_zero_is_told(tmp_path: Path) -> None:
    """15 of 12 tubers counted, 18 % of the belt seen, and nothing said why."""

    def told(name: str, *, zero_m: float, clock_s: float = 0.0, **more: bool) -> list[str]:
        story = tell(28, n=70, length_m=5.0, noise_mm=1.5, split=0.0, **more)
        log = [
            replace(
                e,
                track=e.track and replace(e.track, crossed_x_m=e.track.crossed_x_m - zero_m),
                mark=e.mark
                and replace(
                    e.mark,
                    captured_ns=e.mark.captured_ns + round(clock_s * 1e9),
                    travel_m=e.mark.travel_m + zero_m,
                    complete_place_x_m=e.mark.complete_place_x_m - zero_m,
                ),
            )
            for e in story.logs["cam1"]
        ]
        _, found = counted(tmp_path / name, replace(story, logs={**story.logs, "cam1": log}))
        with reading(tmp_path / name / "ledger.db") as view:
            return zeros_told(view, story.run, story.names, found)

    (text,) = told("shifted", zero_m=5.0)
    assert "camera 'cam1' tells 5.00 m more travel than camera 'cam0' at the same time" in text
    assert "Give travel_m of both from one zero" in text
    assert told("same", zero_m=0.0) == told("no encoder", zero_m=5.0, estimated=True) == []
    assert told("no common time", zero_m=5.0, clock_s=3600.0) == []
    assert told("clocks that differ", zero_m=0.0, clock_s=2.0) == [], "the tubers that both see lie at one place"
