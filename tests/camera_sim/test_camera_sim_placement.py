"""Bodies on the belt: a single layer in which nothing overlaps."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from camera_sim.sim.placement import CROWDED, SINGULATED, TOUCHING, Lane, Packing
from camera_sim.sim.poses import free_rotation, rest_on_belt
from camera_sim.sim.tubers import draw_tuber

CELL_M = 0.0005
LANE_M = (-0.25, 0.25)


def _placed(packing: Packing, rng: np.random.Generator, count: int = 60) -> list[np.ndarray]:
    lane = Lane(*LANE_M, packing=packing)
    placed = []
    for _ in range(count):
        tuber = draw_tuber(rng, level=2)
        points = rest_on_belt(tuber.vertices, free_rotation(rng))
        x, y = lane.add(points, rng)
        placed.append(points[:, :2] + np.array([x, y]))
    return placed


def _outlines(placed: list[np.ndarray]) -> list[np.ndarray]:
    low = np.min([p.min(axis=0) for p in placed], axis=0) - 0.03
    return [np.round((p[ConvexHull(p).vertices] - low) / CELL_M).astype(np.int32) for p in placed]


@pytest.mark.parametrize("packing", [SINGULATED, TOUCHING, CROWDED])
def test_outlines_do_not_overlap(packing: Packing, rng: np.random.Generator) -> None:
    outlines = _outlines(_placed(packing, rng))
    size = np.max([o.max(axis=0) for o in outlines], axis=0) + 60
    layers = np.zeros((int(size[1]), int(size[0])), np.uint8)
    for outline in outlines:
        one = cv2.fillPoly(np.zeros_like(layers), [outline], 1)
        layers += cv2.erode(one, np.ones((3, 3), np.uint8))
    assert layers.max() == 1


def test_bodies_stay_in_their_lane(rng: np.random.Generator) -> None:
    for points in _placed(CROWDED, rng):
        assert points[:, 1].min() >= LANE_M[0] - 1e-9
        assert points[:, 1].max() <= LANE_M[1] + 1e-3


def test_crowded_is_tight_touching_less_and_singulated_apart(rng: np.random.Generator) -> None:
    cover = {}
    for name, packing in (("crowded", CROWDED), ("touching", TOUCHING), ("singulated", SINGULATED)):
        placed = _placed(packing, rng, 120)
        area = sum(ConvexHull(p).volume for p in placed)
        length = max(p[:, 0].max() for p in placed) - min(p[:, 0].min() for p in placed)
        cover[name] = area / (length * (LANE_M[1] - LANE_M[0]))
    assert cover["crowded"] > 0.6
    assert cover["singulated"] < 0.45 < cover["touching"] < cover["crowded"]


def test_singulated_bodies_keep_12_mm(rng: np.random.Generator) -> None:
    outlines = _outlines(_placed(SINGULATED, rng, 30))
    size = np.max([o.max(axis=0) for o in outlines], axis=0) + 60
    grown = np.zeros((int(size[1]), int(size[0])), np.uint8)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (23, 23))  # 6 mm either side
    for outline in outlines:
        grown += cv2.dilate(cv2.fillPoly(np.zeros_like(grown), [outline], 1), kernel)
    assert grown.max() == 1


def test_what_is_wider_than_the_lane_is_said() -> None:
    lane = Lane(0.0, 0.03, packing=TOUCHING)
    tuber = draw_tuber(np.random.default_rng(1), level=2)
    assert lane.add(tuber.vertices, np.random.default_rng(1)) is None
