"""Tubers that lie on others: by their rims and by those around them; a belt in one layer stays as it is."""

from __future__ import annotations

from dataclasses import replace as changed

import numpy as np
import pytest

from camera_sim.sim.presets import EASY_PRESET
from camera_sim.sim.scenes import SCENES, SceneSettings, build_world
from camera_sim.sim.source import SimulatedSource, simulated_sources
from conveyor.messages import Frame, Track
from segmenter.frame.rims import RIM_HEIGHTS, rim_heights
from segmenter.pipeline import Segmenter, Settings
from segmenter.track.layers import LEAST_AROUND, MOST_OF_TOP, BeltLayers, evidence

BOX = np.array([20, 59, 20, 59])


def raster(*, ground_mm: float, rim_mm: float, top_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """A cone of 40 mm across in cells of 1 mm."""
    rows, columns = np.mgrid[:80, :80]
    away = np.hypot(rows - 39.5, columns - 39.5)
    inside = away <= 20
    height = np.where(inside, top_mm + (rim_mm - top_mm) * away / 20, ground_mm).astype(np.float32)
    return inside.astype(np.int32), height


HIGH = np.array([9.0, 62, 72, 2, 20, 44, 90, 0.6])
LYING = np.array([8.0, 30, 36, 0, 1, 6, 55, 0.15])
STANDING = np.array([8.0, 60, 75, 0, 1, 20, 95, 0.1])
"""Readings as simulated tubers have them in the median, and one that stands on end."""


def test_rims_are_read_inside_and_outside_of_the_outline() -> None:
    labels, height = raster(ground_mm=10, rim_mm=30, top_mm=70)
    found = dict(zip(RIM_HEIGHTS, rim_heights(labels, height, 1, BOX, 1.0), strict=True))
    assert found["outer_25"] == found["outer_75"] == 10
    assert 34 <= found["inner_50"] <= 38, "3 mm inside, on a flank that rises by 2 mm per mm"
    assert 30 <= found["edge_10"] <= 33
    assert np.isnan(rim_heights(labels, height, 2, BOX, 1.0)).all(), "no such label"


def test_a_tuber_among_many_that_lie_on_others_does_too_and_a_lone_one_does_not() -> None:
    belt, said = BeltLayers(), evidence([HIGH])
    assert said is not None
    high_m = belt.support_m([HIGH], [said] * 6)
    assert 0.02 < high_m < MOST_OF_TOP * 0.09
    assert belt.support_m([HIGH], [said] * (LEAST_AROUND - 1)) == 0.0
    assert belt.support_m([], [said] * 6) == 0.0
    assert belt.support_m([LYING], [said] * 6) == 0.0, "the lower ones of a heap lie on the belt"


def test_one_that_stands_on_end_in_a_single_layer_stays_on_the_belt() -> None:
    usual = evidence([LYING])
    assert usual is not None
    assert BeltLayers().support_m([STANDING], [usual] * 12) == 0.0


def frames(piled: float, seed: int) -> list[Frame]:
    layout = changed(SCENES["crowded"], piled=piled)
    settings = SceneSettings("crowded", seed, 40, EASY_PRESET, fps=10.0)
    source: SimulatedSource = simulated_sources(build_world(settings, layout), settings, layout)[0]
    return [frame for frame in source.frames(run="r") if isinstance(frame, Frame)]


def tracks(belt: list[Frame]) -> list[Track]:
    core, found = Segmenter(Settings()), []
    for frame in belt:
        found += [closed.track for closed in core.step(frame).closed]
    return found + [closed.track for closed in core.finish()]


@pytest.mark.parametrize(("piled", "least", "most"), [(0.0, 0, 0), (0.45, 5, 22)])
def test_a_heap_is_found_and_a_crowded_belt_is_none(piled: float, least: int, most: int) -> None:
    belt = frames(piled, seed=8801)
    found = tracks(belt)
    on_others = [track for track in found if track.support_mm > 0]
    assert least <= len(on_others) <= most
    assert all(8 <= track.support_mm <= 80 and track.height_mm > 15 for track in on_others)
    assert found == tracks(belt), "the same frames give the same tracks"
