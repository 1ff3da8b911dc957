"""How far a camera's outlines are off, by the same tubers in several frames; and what is cut back."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from segmenter_scene import MEDIUM, Scene, scattered, seen_px, worn

from conveyor.belt_findings import belt_findings
from conveyor.camera_flags import OUTLINE_GROWN
from conveyor.messages import Frame
from segmenter.outline.growth import without_growth
from segmenter.outline.watch import OutlineReading
from segmenter.pipeline import ClosedTrack, Segmenter, Settings

STEP_M = 0.03
FRAMES = 66

Belt = list[tuple[Frame, NDArray[np.uint8]]]
"""Its frames, each with where tubers are in it."""


def run(frames: Iterable[Frame]) -> tuple[Segmenter, list[ClosedTrack], OutlineReading]:
    core, closed = Segmenter(Settings()), []
    for frame in frames:
        closed += core.step(frame).closed
    reading = core.outlines
    assert reading is not None
    return core, closed, reading


@pytest.fixture(scope="module")
def belt() -> Belt:
    scene = Scene([replace(b, place_x_m=2 * b.place_x_m) for b in scattered(15, seed=4)], MEDIUM, noise_m=0.0003)
    clear = replace(scene, noise_m=0.0)
    return [
        (scene.frame(seq, seq * STEP_M), (clear.render(seq * STEP_M)[1] > 0).astype(np.uint8)) for seq in range(FRAMES)
    ]


@pytest.fixture(scope="module")
def clean(belt: Belt) -> tuple[Segmenter, list[ClosedTrack], OutlineReading]:
    return run(frame for frame, _ in belt)


@pytest.fixture(scope="module")
def grown(belt: Belt) -> list[Frame]:
    return [worn(frame, body, 3) for frame, body in belt]


def test_outlines_as_they_are_stay_as_they_are(clean: tuple[Segmenter, list[ClosedTrack], OutlineReading]) -> None:
    core, closed, reading = clean
    assert abs(reading.lost_px) < 0.4
    assert abs(reading.farther) < 0.003
    assert reading.grown_px == 0
    assert core.gauges()["outline_grown_px"] == 0
    assert belt_findings("front", core.gauges()) == {}
    assert all(OUTLINE_GROWN not in c.track.flags for c in closed)


def test_outlines_that_grow_are_measured_told_and_cut_back(
    grown: list[Frame], clean: tuple[Segmenter, list[ClosedTrack], OutlineReading]
) -> None:
    core, closed, reading = run(grown)
    assert reading.lost_px == pytest.approx(clean[2].lost_px - 3, abs=0.5)
    assert reading.grown_px == pytest.approx(-reading.lost_px, abs=0.3)
    assert f"outlines are {reading.grown_px:.1f} px larger" in belt_findings("front", core.gauges())["outline_grown_px"]
    flagged = [OUTLINE_GROWN in c.track.flags for c in closed]
    assert flagged == sorted(flagged)  # from the moment on from which it is known
    assert not flagged[0]
    assert flagged[-1]
    as_they_are, cut = seen_px(clean[1]), seen_px([c for c in closed if OUTLINE_GROWN in c.track.flags])
    uncut = seen_px([c for c in closed if OUTLINE_GROWN not in c.track.flags])
    assert all(n == pytest.approx(as_they_are[place], rel=0.06) for place, n in cut.items())
    assert all(n > 1.08 * as_they_are[place] for place, n in uncut.items())


def test_outlines_that_are_lost_are_measured_and_left(
    belt: Belt, clean: tuple[Segmenter, list[ClosedTrack], OutlineReading]
) -> None:
    core, _, reading = run(worn(frame, body, -1) for frame, body in belt)
    assert reading.lost_px == pytest.approx(clean[2].lost_px + 1, abs=0.4)
    assert core.gauges()["outline_grown_px"] == 0


def test_a_travel_that_disagrees_with_the_distances_is_no_outline(belt: Belt) -> None:
    core, _, reading = run(replace(frame, travel_m=0.97 * STEP_M * frame.seq) for frame, _ in belt)
    assert reading.farther == pytest.approx(0.03, abs=0.006)
    assert abs(reading.lost_px) < 1.0
    assert reading.grown_px == 0
    told = f"it puts tubers {100 * reading.farther:.1f} % farther than the belt's travel says"
    assert told in belt_findings("front", core.gauges())["farther_than_travel"]


def test_a_belt_without_an_encoder_says_the_same_of_its_outlines(grown: list[Frame]) -> None:
    _, _, reading = run(replace(frame, travel_m=None) for frame in grown)
    assert reading.grown_px == pytest.approx(3, abs=0.6)
    assert abs(reading.farther) < 0.01


def test_only_what_is_known_to_be_lost_makes_weights_heavier() -> None:
    known = OutlineReading(
        lost_px=4.0, sd_px=0.3, as_seen_px=4.2, mm_per_px=1.0, farther=0.0, farther_sd=0.001, tubers=20
    )
    assert known.lost_beyond_mm == pytest.approx(2.4, abs=0.1)
    assert known.grown_px == 0
    for less in ({"tubers": 5}, {"as_seen_px": 1.0}, {"sd_px": 3.0}, {"lost_px": 1.5}):
        assert replace(known, **less).lost_beyond_mm == 0  # type: ignore[arg-type]


def disc(radius: int) -> NDArray[np.uint16]:
    v, u = np.mgrid[-40:41, -40:41]
    return np.where(np.hypot(u, v) <= radius, 400, 0).astype(np.uint16)


def test_growth_is_cut_from_outside_alone() -> None:
    holed = disc(30)
    holed[38:43, 38:43] = 0
    cut = without_growth(holed, 4.0)
    assert np.count_nonzero(disc(25)) <= np.count_nonzero(cut) + 25 <= np.count_nonzero(disc(26))
    assert np.array_equal(cut[30:51, 30:51], holed[30:51, 30:51])
    assert without_growth(holed, 0.0) is holed
    small = disc(5)
    assert without_growth(small, 4.0) is small
