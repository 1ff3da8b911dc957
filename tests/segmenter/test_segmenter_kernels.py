"""The compiled kernels give the numbers of their plain forms, bit for bit: they are only in another order of memory."""

from __future__ import annotations

from itertools import product

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.constants import CEILING_MM
from segmenter.frame.flood import LEVEL_MM, flood
from segmenter.frame.heights import _blocks, height_map
from segmenter.frame.instances import given
from segmenter.frame.seams import END_ROWS, _seams
from segmenter.frame.sums import STEP_MM, STEPS, instance_sums
from segmenter.track.constants import LEAST_HEIGHT_M
from segmenter.track.views import cut_out

SHAPE = (37, 51)
AROUND = [step for step in product((-1, 0, 1), repeat=2) if step != (0, 0)]
BESIDE = [(-1, 0), (1, 0), (0, -1), (0, 1)]


@pytest.fixture(params=[1, 2, 3])
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    return np.random.default_rng(request.param)


def near(i: int, j: int, steps: list[tuple[int, int]]) -> list[tuple[int, int]]:
    places = [(i + di, j + dj) for di, dj in steps]
    return [(y, x) for y, x in places if 0 <= y < SHAPE[0] and 0 <= x < SHAPE[1]]


def bumps(rng: np.random.Generator) -> NDArray[np.float32]:
    """A smooth relief of quarter millimetres, so that many cells are equally high."""
    rough = cv2.GaussianBlur(rng.uniform(0, 60, SHAPE).astype(np.float32), (7, 7), 0)
    return (np.round(rough * 4) / 4).astype(np.float32)


def labels_of(rng: np.random.Generator) -> NDArray[np.int32]:
    """Blobs that touch each other and the borders, and bare cells."""
    coarse = rng.integers(0, 6, (8, 11)).astype(np.int32)
    return np.ascontiguousarray(np.kron(coarse, np.ones((5, 5), np.int32))[: SHAPE[0], : SHAPE[1]])


def plain_flood(
    relief: NDArray[np.float32], foreground: NDArray[np.uint8], least_mm: float, share: float
) -> NDArray[np.int32]:
    """Cells in falling order, one by one, each with a dictionary lookup of its basin."""
    cells = [(i, j) for i in range(SHAPE[0]) for j in range(SHAPE[1]) if foreground[i, j]]
    cells.sort(key=lambda c: -max(0, int(relief[c] / np.float32(LEVEL_MM))))
    parent: dict[tuple[int, int], tuple[int, int]] = {}

    def find(cell: tuple[int, int]) -> tuple[int, int]:
        while parent[cell] != cell:
            cell = parent[cell]
        return cell

    for cell in cells:
        flooded = [place for place in near(*cell, AROUND) if place in parent]
        if not flooded:
            parent[cell] = cell
            continue
        root = parent[cell] = find(max(flooded, key=lambda place: relief[place]))
        for other in map(find, flooded):
            root = find(root)
            other = find(other)
            if other != root:
                low, high = (other, root) if relief[other] < relief[root] else (root, other)
                if relief[low] - relief[cell] < max(least_mm, share * relief[low]):
                    parent[low] = high
                    root = high
    labels, names = np.zeros(SHAPE, np.int32), dict[tuple[int, int], int]()
    for cell in cells:
        labels[cell] = names.setdefault(find(cell), len(names) + 1)
    return labels


def test_flooding(rng: np.random.Generator) -> None:
    relief, foreground = bumps(rng), (rng.random(SHAPE) < 0.9).astype(np.uint8)
    labels, n = flood(relief, foreground, 0.4, 0.02)
    assert n > 3
    np.testing.assert_array_equal(labels, plain_flood(relief, foreground, 0.4, 0.02))


def test_seams(rng: np.random.Generator) -> None:
    labels, height = labels_of(rng), bumps(rng)
    n = int(labels.max())
    seams = _seams(labels, n, height)
    length, low, jump = (np.zeros((n + 1, n + 1)) for _ in range(3))
    cells, outline, top, at_end = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1, bool)
    for i, j in product(range(SHAPE[0]), range(SHAPE[1])):
        a = labels[i, j]
        if a:
            cells[a] += 1
            top[a] = max(top[a], height[i, j])
            at_end[a] |= i < END_ROWS or i >= SHAPE[0] - END_ROWS
        for (di, dj), (y, x) in zip([(0, 1), (1, 0)], [(i, j + 1), (i + 1, j)], strict=True):
            if y >= SHAPE[0] or x >= SHAPE[1] or labels[y, x] == a:
                continue
            b = labels[y, x]
            outline[[a, b]] += 1
            if a and b:
                before, after = (
                    height[max(0, i - di), max(0, j - dj)],
                    height[min(SHAPE[0] - 1, y + di), min(SHAPE[1] - 1, x + dj)],
                )
                for pair in ((a, b), (b, a)):
                    length[pair] += 1
                    low[pair] += min(height[i, j], height[y, x])
                    jump[pair] += abs(before - after)
    for found, wanted in zip(seams, (length, low, jump, cells, outline, top, at_end), strict=True):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("margin", [1, 2])
def test_sums(rng: np.random.Generator, margin: int) -> None:
    labels, height = labels_of(rng), bumps(rng)
    n, (a, b, c, t) = int(labels.max()), (-0.2, 0.1, -990.0, 460.0)
    sums, histogram = instance_sums(
        labels, n, height, coefficients_mm=(a, b, c, t), stride=2, area_factor=1.7, margin=margin
    )
    for k in range(1, n + 1):
        places = [(i, j) for i, j in product(range(SHAPE[0]), range(SHAPE[1])) if labels[i, j] == k]
        area = volume = 0.0
        steps = np.zeros(STEPS, np.int32)
        touching = outline = 0
        for i, j in places:
            slope = a * (j * 2 + 0.5) + b * (i * 2 + 0.5) + c
            h = float(height[i, j])
            z = (h - t) / slope
            cell = 1.7 * z * z / abs(slope * 1e-3)
            area += cell
            volume += cell * h
            steps[min(STEPS - 1, int(h / STEP_MM))] += 1
            others = [labels[place] for place in near(i, j, BESIDE) if labels[place] != k]
            outline += bool(others)
            touching += any(others)
        rows, columns = np.array(places).T
        row = sums[k]
        assert (row["area_mm2"], row["volume_mm3"]) == (area, volume)
        assert (row["cells"], row["rows"], row["columns"]) == (len(places), rows.sum(), columns.sum())
        assert (row["outline"], row["touching"]) == (outline, touching)
        ends = (rows < margin, rows >= SHAPE[0] - margin, columns < margin, columns >= SHAPE[1] - margin)
        assert tuple(row[["top", "bottom", "left", "right"]]) == tuple(int(end.sum()) for end in ends)
        box = (rows.min(), rows.max(), columns.min(), columns.max())
        assert tuple(row[["first_row", "last_row", "first_column", "last_column"]]) == box
        assert row["peak_mm"] == max(height[i, j] for i, j in places)
        np.testing.assert_array_equal(histogram[k], steps)


def test_heights_of_single_pixels_are_those_of_blocks_of_one(rng: np.random.Generator) -> None:
    """A frame of 2x2 blocks of equal pixels on a level belt: their mean is the height of each."""
    depth = rng.integers(380, 470, SHAPE).astype(np.uint16)
    depth[rng.random(SHAPE) < 0.1] = 0
    height, seen = _blocks(depth, 0.001, 0.0, 0.0, -1000.0, 460.0, 1, CEILING_MM)
    doubled, seen_too = _blocks(
        np.kron(depth, np.ones((2, 2), np.uint16)), 0.001, 0.0, 0.0, -1000.0, 460.0, 2, CEILING_MM
    )
    np.testing.assert_array_equal(height, doubled)
    np.testing.assert_array_equal(seen, seen_too)


def test_a_crop_holds_what_stands_over_the_belt(rng: np.random.Generator) -> None:
    depth = np.kron(rng.integers(420, 462, SHAPE).astype(np.uint16), np.ones((2, 2), np.uint16))
    depth[rng.random(depth.shape) < 0.1] = 0
    intrinsics = Intrinsics(depth.shape[1], depth.shape[0], 600.0, 610.0, 50.0, 40.0)
    belt = BeltGeometry(intrinsics, straight_down_belt_from_camera(0.46))
    frame = Frame(
        camera="front", run="r", seq=0, captured_ns=0, travel_m=0.0, depth_scale_m=0.001, intrinsics=intrinsics,
        belt_distance_m=None, belt_from_camera=None, depth=depth,
    )  # fmt: skip
    heights = height_map(depth, depth_scale_m=0.001, belt=belt, pixel_mm=1.45)
    mask = np.kron(labels_of(rng).astype(np.uint16), np.ones((2, 2), np.uint16))
    instances = given(mask, heights, belt)
    a, b, c, t = belt.height_coefficients()
    for index in range(len(instances)):
        i0, i1, j0, j1 = (int(value) * instances.stride for value in instances.box[index])
        rows, columns = slice(i0, i1 + instances.stride), slice(j0, j1 + instances.stride)
        found = cut_out(frame, instances, index, belt, offset_m=0.0)
        assert found is not None
        v, u = np.mgrid[rows, columns]
        high = depth[rows, columns] * 0.001 * (a * u + b * v + c) + t > LEAST_HEIGHT_M
        full = np.kron(instances.labels, np.ones((instances.stride,) * 2, np.int32))[rows, columns] == index + 1
        np.testing.assert_array_equal(found.depth, np.where(full & high, depth[rows, columns], 0))
