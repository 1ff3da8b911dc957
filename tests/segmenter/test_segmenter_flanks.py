"""Flanks that a camera's matching window raises: measured on tubers that are seen from two sides, and taken off."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from segmenter_scene import MEDIUM, Scene, scattered

from conveyor.camera_flags import FLANKS_RAISED
from conveyor.messages import Frame
from segmenter.outline.flanks import BINS, FlankReading, FlankWatch, without_rise
from segmenter.pipeline import ClosedTrack, Segmenter, Settings

STEP_M, FRAMES = 0.03, 66
REACH_PX, RISE_M = 8.0, 0.0012

Belt = list[tuple[Frame, NDArray[np.uint8]]]
"""Its frames, each with where tubers are in it."""


@pytest.fixture(scope="module")
def belt() -> Belt:
    scene = Scene([replace(b, place_x_m=2 * b.place_x_m) for b in scattered(15, seed=4)], MEDIUM, noise_m=0.0003)
    clear = replace(scene, noise_m=0.0)
    return [
        (scene.frame(seq, seq * STEP_M), (clear.render(seq * STEP_M)[1] > 0).astype(np.uint8)) for seq in range(FRAMES)
    ]


def rise_m(inside_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of flanks, by pixels inside the outline: most at it, none from `REACH_PX` on."""
    return RISE_M * np.clip(1 - inside_px / REACH_PX, 0, 1)


def bent(frame: Frame, body: NDArray[np.uint8], share: float) -> Frame:
    """The frame with its tubers' flanks nearer by `share` of `rise_m`; below 0 farther away."""
    inside_px = cv2.distanceTransform(body, cv2.DIST_L2, 5).astype(np.float64)
    moved = np.where(body, share * rise_m(inside_px) / frame.depth_scale_m, 0.0)
    return replace(frame, depth=np.rint(frame.depth - moved).astype(np.uint16))


def run(belt: Belt, share: float) -> tuple[Segmenter, list[ClosedTrack]]:
    core, closed = Segmenter(Settings()), []
    for frame, body in belt:
        closed += core.step(bent(frame, body, share)).closed
    return core, closed


def test_raised_flanks_are_measured_told_and_taken_off(belt: Belt) -> None:
    core, closed = run(belt, 1.0)
    reading = core.flanks
    assert reading is not None
    inside = np.arange(2, 5)
    assert np.array(reading.risen_mm)[inside] == pytest.approx(1000 * rise_m(inside + 0.5), abs=0.25)
    told = [FLANKS_RAISED in c.track.flags for c in closed]
    assert told == sorted(told)  # from the moment on from which it is known
    assert not told[0]
    assert told[-1]
    for c in closed:
        off_mm = nearer_mm(c, belt)
        assert abs(off_mm) < 0.25 if FLANKS_RAISED in c.track.flags else off_mm > 0.7, c.track.place_x_m


def nearer_mm(closed: ClosedTrack, belt: Belt) -> float:
    """By how much the flanks of the best view are nearer than they were in the frame before it was bent."""
    view = closed.views[0]
    frame, body = belt[view.seq]
    there = np.s_[view.v0 : view.v0 + view.depth.shape[0], view.u0 : view.u0 + view.depth.shape[1]]
    inside_px = cv2.distanceTransform(body, cv2.DIST_L2, 5)[there]
    flank = (inside_px > 1.5) & (inside_px < 5) & (view.depth > 0)
    return float(np.mean(frame.depth[there][flank].astype(np.float64) - view.depth[flank]) * 1000 * view.depth_scale_m)


@pytest.mark.parametrize("share", [0.0, -1.0])
def test_flanks_that_are_not_raised_stay_as_they_are(belt: Belt, share: float) -> None:
    """A camera that blurs outlines lowers flanks; the weights know such cameras."""
    core, closed = run(belt, share)
    assert core.flanks is not None
    assert core.flanks.judged_mm < 0.15 + min(share, 0) * 0.4
    assert core.flanks.raised_m == ()
    assert all(FLANKS_RAISED not in c.track.flags for c in closed)


def test_only_what_is_known_to_be_raised_is_taken_off() -> None:
    risen_mm = (3.0, 2.0, 0.9, 0.6, 0.5, 0.3, 0.2, 0.05, 0.3, *[float("nan")] * 3)
    known = FlankReading(risen_mm=risen_mm, sd_mm=0.1, tubers=20)
    assert known.raised_m == (0.0009, 0.0009, 0.0009, 0.0006, 0.0005, 0.0003, 0.0002)
    assert replace(known, sd_mm=0.3).raised_m == ()
    assert replace(known, risen_mm=tuple(0.3 * mm for mm in risen_mm)).raised_m == ()
    assert replace(known, risen_mm=(float("nan"),) * BINS).raised_m == ()


def test_few_tubers_say_nothing_and_only_the_newest_are_kept() -> None:
    watch = FlankWatch()
    for tuber in range(3):
        watch.add(tuber, np.full(BINS, 0.001))
        assert watch.reading is None
    watch.add(3, np.full(BINS, 0.001))
    assert watch.reading == FlankReading(risen_mm=(1.0,) * BINS, sd_mm=0.0, tubers=4)
    for tuber in range(4, 200):
        watch.add(tuber, np.full(BINS, 0.002))
    assert watch.reading.risen_mm == (2.0,) * BINS


def test_what_is_taken_off_fades_inside_and_empty_pixels_stay_empty() -> None:
    depth = np.zeros((60, 60), np.uint16)
    depth[10:50, 10:50] = 4000
    depth[25:28, 25:28] = 0  # a hole is no outline
    lowered = without_rise(depth, (0.001, 0.0005), depth_scale_m=0.0001)
    assert np.array_equal(lowered > 0, depth > 0)
    assert lowered[30, 10] == 4008  # outermost pixel, half a pixel inside: 1.0 to 0.5 mm at 1.5
    assert [int(lowered[30, 10 + n]) for n in range(4)] == sorted(
        (int(lowered[30, 10 + n]) for n in range(4)), reverse=True
    )
    assert lowered[24, 24] == lowered[30, 20] == 4000
    assert without_rise(depth, (), depth_scale_m=0.0001) is depth
