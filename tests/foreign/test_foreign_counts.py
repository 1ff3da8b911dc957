"""Recordings of a simulator that shares nothing with ours: every tuber counted once, at its true place."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foreign_belt import Habits, View, posed, rows, straight_down, strew, write
from scipy.optimize import linear_sum_assignment

from conveyor.formats import Refused, open_source
from segmenter.pipeline import Segmenter, Settings

SMALL = View(size=(424, 240), focal=240.0, fps=15)
TILTED = posed(0.46, tilt_deg=5)
NARROW = Habits(belt_half_m=0.16, floor_m=0.25)


def counted(recording: Path) -> tuple[list[tuple[float, float]], Segmenter, int]:
    """Places of all counted tubers, the segmenter after the last frame, and how many frames it dropped."""
    core, closed, dropped = Segmenter(Settings()), [], 0
    for frame in open_source(recording, camera="cam").frames(run="foreign"):
        assert not isinstance(frame, Refused), frame
        result = core.step(frame)
        dropped += bool(result.dropped)
        closed += result.closed
    closed += core.finish()
    return [(c.track.place_x_m, c.track.y_m) for c in closed], core, dropped


def assert_same(found: list[tuple[float, float]], truth: list[dict[str, float]], *, within_m: float) -> None:
    """Same count, and one to one within a distance; without any alignment of their zeros."""
    assert len(found) == len(truth)
    true = np.array([(t["place_x_m"], t["place_y_m"]) for t in truth])
    apart = np.linalg.norm(np.array(found)[:, None] - true[None], axis=2)
    assert apart[linear_sum_assignment(apart)].max() < within_m


@pytest.mark.parametrize(
    ("view", "habits", "within_m"),
    [
        pytest.param(SMALL, Habits(), 0.003, id="encoder"),
        pytest.param(replace(SMALL, fps=10), Habits(travel=False), 0.006, id="10 fps, travel estimated"),
        pytest.param(
            SMALL, Habits(travel=False, noise_mm=1.5, holes=0.1, rods_mm=6, drop=0.1), 0.008, id="noise, rods, losses"
        ),
        pytest.param(replace(SMALL, told_distance=False, belt_from_camera=TILTED), Habits(), 0.005, id="untold tilt"),
        pytest.param(replace(SMALL, told_distance=False), NARROW, 0.003, id="untold distance, floor beside the belt"),
        pytest.param(replace(SMALL, belt_from_camera=straight_down(0.4)), replace(NARROW, belt_half_m=0.12), 0.003,
                     id="more floor than belt"),
        pytest.param(replace(SMALL, told_pose=True, belt_from_camera=posed(0.46, turn_deg=90, at_m=(0.3, 0.1))),
                     Habits(colour="png", masks=True), 0.005, id="belt along the columns"),
        pytest.param(replace(SMALL, told_pose=True, belt_from_camera=posed(0.46, turn_deg=-90)), Habits(), 0.003,
                     id="belt against the columns"),
        pytest.param(replace(SMALL, told_pose=True, belt_from_camera=posed(0.46, turn_deg=180, roll_deg=4)),
                     Habits(travel=False), 0.006, id="upside down"),
    ],
)  # fmt: skip
def test_every_tuber_is_counted_once_at_its_place(view: View, habits: Habits, within_m: float, tmp_path: Path) -> None:
    half_m = 0.09 if habits.belt_half_m or abs(view.belt_from_camera[0, 1]) < 0.5 else 0.17
    centre = view.belt_from_camera[:2, 3] if view.told_pose else (0.0, 0.0)
    tubers = strew(np.random.default_rng(3), 9, length_m=0.7, half_width_m=half_m, start_m=centre[0] + 0.1)
    tubers = [replace(t, place_m=(t.place_m[0], t.place_m[1] + centre[1])) for t in tubers]
    truth = write(tmp_path, tubers, [view], travel_at=lambda t: 0.3 * t, seconds=1.6, habits=habits)["tubers"]
    assert len(truth) >= 3
    assert_same(counted(tmp_path)[0], truth, within_m=within_m)


def test_rows_that_touch_are_counted_one_by_one(tmp_path: Path) -> None:
    view = View(fps=10, unit_m=1e-4)
    tubers = rows(np.random.default_rng(2), 12, per_row=4, start_m=0.0, half_width_m=0.14)
    truth = write(tmp_path, tubers, [view], travel_at=lambda t: 0.3 * t, seconds=1.5)["tubers"]
    assert len(truth) >= 8
    assert_same(counted(tmp_path)[0], truth, within_m=0.005)


@pytest.mark.parametrize("tubers", [0, 1])
def test_an_empty_belt_without_noise_was_looked_at(tubers: int, tmp_path: Path) -> None:
    """Frames of an empty belt are all alike; they were taken for those of a frozen camera, and coverage fell to 0."""
    laid = strew(np.random.default_rng(1), tubers, length_m=0.1, half_width_m=0.1, start_m=0.0)
    truth = write(tmp_path, laid, [SMALL], travel_at=lambda t: 0.4 * t, seconds=2.0)["tubers"]
    found, core, dropped = counted(tmp_path)
    assert (len(found), len(truth), dropped) == (tubers, tubers, 0)
    assert core.looked_at_m == core.travelled_m == pytest.approx(0.4 * 29 / 15)


def test_a_frozen_picture_of_tubers_is_still_refused(tmp_path: Path) -> None:
    laid = strew(np.random.default_rng(1), 4, length_m=0.2, half_width_m=0.1, start_m=0.1)
    write(tmp_path, laid, [SMALL], travel_at=lambda t: 0.3 * t, seconds=0.5)
    depth = tmp_path / "cam" / "depth"
    for seq in (3, 4):
        (depth / f"{seq:06d}.png").write_bytes((depth / "000002.png").read_bytes())
    assert counted(tmp_path)[2] == 2


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_recordings_of_a_few_frames(frames: int, tmp_path: Path) -> None:
    tubers = strew(np.random.default_rng(5), 12, length_m=0.4, half_width_m=0.17, start_m=0.2)
    truth = write(tmp_path, tubers, [SMALL], travel_at=lambda t: 0.6 * t, seconds=frames / 15 + 1e-6)["tubers"]
    assert len(counted(tmp_path)[0]) == len(truth)


def test_file_habits_of_others(tmp_path: Path) -> None:
    """CRLF, spaces, a byte-order mark, further keys, 16 numbers in one list, numbers that start high, clocks at 0."""
    habits = Habits(newline="\r\n", spaces=True, extra_keys=True, colour="jpg")
    view = replace(SMALL, told_pose=True, first_seq=999_995, clock_ns=0)
    tubers = strew(np.random.default_rng(3), 6, length_m=0.5, half_width_m=0.15, start_m=0.1)
    truth = write(tmp_path, tubers, [view], travel_at=lambda t: 0.3 * t, seconds=1.0, habits=habits)["tubers"]
    rows_file, camera_file = tmp_path / "cam" / "frames.csv", tmp_path / "cam" / "camera.json"
    rows_file.write_bytes(b"\xef\xbb\xbf" + rows_file.read_bytes() + b"\r\n")
    camera = json.loads(camera_file.read_text())
    flat = [value for row in camera["belt_from_camera"] for value in row]
    camera_file.write_text(json.dumps(camera | {"belt_from_camera": flat}))
    assert_same(counted(tmp_path)[0], truth, within_m=0.003)
