"""Two cameras without an encoder: what one tells the other of the belt's travel, and where travel starts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from foreign_belt import Habits, View, strew, write

from aggregator.core.travel import TravelCurve, head_start_m
from conveyor.config import CameraConfig, LineConfig
from conveyor.formats import Refused, open_source
from segmenter.camera_run import CameraRun
from segmenter.setup import run_settings


def stop_and_go(t: float) -> float:
    """0.4 m/s with a halt of 0.7 s, metres."""
    return 0.4 * (t if t < 0.9 else 0.9 if t < 1.6 else t - 0.7)


def test_marks_tell_the_others_of_a_belt_that_stops(tmp_path: Path) -> None:
    """Marks came every second: travel taken for a line between them was 100 mm off, and every tuber counted twice."""
    view = View(size=(424, 240), focal=240.0, fps=30)
    tubers = strew(np.random.default_rng(4), 12, length_m=1.0, half_width_m=0.15, start_m=0.2)
    write(tmp_path, tubers, [view], travel_at=stop_and_go, seconds=2.5, habits=Habits(travel=False))
    line = LineConfig(cameras={"cam": CameraConfig(path=tmp_path)})
    camera_run, curve, marks = CameraRun("cam", "run", run_settings(line, "cam"), None), TravelCurve(), 0
    camera_run.open()
    for frame in open_source(tmp_path, camera="cam").frames(run="run"):
        assert not isinstance(frame, Refused)
        camera_run.frame(frame, 0.0)
        camera_run.tick(0.0, set())
        for entry in camera_run.log.due(0.0):
            if entry.mark is not None:
                curve.add(entry.mark.captured_ns, entry.mark.travel_m)
                marks += 1
    seconds = np.arange(0, (curve.times_ns[-1] - view.clock_ns) / 1e9, 0.02)
    off_m = [curve.at(view.clock_ns + round(t * 1e9)) - stop_and_go(t) for t in seconds.tolist()]
    assert seconds[-1] > 1.6
    assert np.abs(off_m).max() < 0.015
    assert marks < 30


def curve(*samples: tuple[int, float], closed: bool = False) -> TravelCurve:
    made = TravelCurve(closed=closed)
    for t_ns, x_m in samples:
        made.add(t_ns, x_m)
    return made


def test_travel_starts_with_the_earliest_camera() -> None:
    second = 1_000_000_000
    late = {"a": curve((second, 0.0), (2 * second, 0.4)), "b": curve((0, 0.1), (2 * second, 0.9))}
    assert head_start_m(late, reference="a") == pytest.approx(0.4)
    assert head_start_m(late, reference="b") == 0.0


def test_the_head_start_is_waited_for_and_given_up() -> None:
    late = {"a": curve((100, 0.0)), "b": curve((0, 0.0))}
    assert head_start_m(late, reference="a") is None
    late["b"].closed = True
    assert head_start_m(late, reference="a") == 0.0
    assert head_start_m({"a": curve((100, 0.0)), "b": curve()}, reference="a") is None
    assert head_start_m({"a": curve((100, 0.0)), "b": curve(closed=True)}, reference="a") == 0.0


def test_another_clock_gives_no_head_start() -> None:
    apart = {"a": curve((10**15, 0.0)), "b": curve((0, 0.0), (10**9, 0.3))}
    assert head_start_m(apart, reference="a") == 0.0
