"""What was made faster beside the splitter's kernels gives the numbers of its plain form."""

from __future__ import annotations

import itertools
import random
import statistics
from bisect import bisect_left

import numpy as np
import pytest
from numpy.typing import NDArray

from segmenter.frame import heights, plane_kernels, rims
from segmenter.frame.edges import cut_by_unseen
from segmenter.frame.flood import regrow
from segmenter.outline.compare import Comparison
from segmenter.outline.watch import _lost_px
from segmenter.track import history
from segmenter.track.history import TravelHistory
from segmenter.track.track import middle
from segmenter.track.views import slot_offsets

SHAPE = (31, 43)


@pytest.fixture(params=[1, 2, 3])
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    return np.random.default_rng(request.param)


def labels_of(rng: np.random.Generator) -> NDArray[np.int32]:
    coarse = rng.integers(0, 4, (6, 8)).astype(np.int32)
    labels = np.ascontiguousarray(np.kron(coarse, np.ones((6, 6), np.int32))[: SHAPE[0], : SHAPE[1]])
    labels[rng.random(SHAPE) < 0.05] = 0
    return labels


def test_rims_are_those_of_the_nearest_cell_beyond_the_outline(rng: np.random.Generator) -> None:
    """By brute force: 3 per straight and 4 per slanting step, in thirds of a cell."""
    labels, height = labels_of(rng), rng.uniform(0, 300, SHAPE).astype(np.float32)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    bounds = rims._BOUNDS_MM / 1.2
    for label in (1, 2, 3):
        away = np.zeros(SHAPE)
        for i, j in np.ndindex(SHAPE):
            beyond = (labels == label) != (labels[i, j] == label)
            down, along = abs(rows[beyond] - i), abs(columns[beyond] - j)
            away[i, j] = (3 * np.maximum(down, along) + np.minimum(down, along)).min() / 3.0
        counts = np.zeros((3, rims.STEPS), np.int64)
        for ring, (low, high) in enumerate(bounds):
            here = (away > low) & (away <= high) & ((labels == label) == (ring < 2))
            np.add.at(counts[ring], np.clip(height[here].astype(int), 0, rims.STEPS - 1), 1)
        np.testing.assert_array_equal(rims._rings(labels, height, label, bounds), counts)


def test_labels_grow_ring_by_ring(rng: np.random.Generator) -> None:
    labels, height = labels_of(rng), rng.uniform(0, 20, SHAPE).astype(np.float32)
    plain = labels.copy()
    front = [
        c for c in np.ndindex(SHAPE) if plain[c] and any(free(plain, height, *n) for n in beside(*c, slanting=False))
    ]
    for step in range(4):
        fresh = []
        for cell in front:
            for near in beside(*cell, slanting=step % 2 == 0):
                if free(plain, height, *near):
                    plain[near] = plain[cell]
                    fresh.append(near)
        front = fresh
    regrow(labels, height, 7.0, 4)
    np.testing.assert_array_equal(labels, plain)


def beside(i: int, j: int, *, slanting: bool) -> list[tuple[int, int]]:
    steps = [(di, dj) for di in (-1, 0, 1) for dj in (-1, 0, 1) if (di or dj) and (slanting or not (di and dj))]
    return [(i + di, j + dj) for di, dj in steps if 0 <= i + di < SHAPE[0] and 0 <= j + dj < SHAPE[1]]


def free(labels: NDArray[np.int32], height: NDArray[np.float32], i: int, j: int) -> bool:
    return bool(labels[i, j] == 0 and height[i, j] > 7.0)


def test_what_lies_at_the_end_of_what_was_seen(rng: np.random.Generator) -> None:
    labels, seen = labels_of(rng), (rng.random(SHAPE) < 0.5).astype(np.uint8)
    seen[:, 7] = 0
    plain, reach = np.zeros((4, 4), np.int64), 2
    for side, (names, lines) in enumerate([(labels.T, seen.T), (labels.T, seen.T), (labels, seen), (labels, seen)]):
        for name, line in zip(names, lines, strict=True):
            known = np.flatnonzero(line)
            if len(known):
                first = (
                    name[known[0] : known[0] + reach + 1]
                    if side % 2 == 0
                    else name[max(known[-1] - reach, 0) : known[-1] + 1]
                )
                if first.any():
                    plain[first[first > 0][0], side] += 1
    np.testing.assert_array_equal(cut_by_unseen(labels, 3, seen, reach), plain)


@pytest.mark.parametrize("n", [3, 4, 50, 300, 12000])
def test_triples_are_those_of_so_many_single_draws(n: int) -> None:
    one, other = np.random.default_rng(20), np.random.default_rng(20)
    singly = np.stack([one.choice(n, 3, replace=False) for _ in range(120)])
    np.testing.assert_array_equal(plane_kernels.triples_of(other, n, 120), singly)


def test_trimmed_planes_are_least_squares_fits(rng: np.random.Generator) -> None:
    x, y = rng.uniform(-1, 1, (2, 4000))
    q = 0.1 * x - 0.05 * y + 2.2 + rng.normal(0, 0.01, 4000)
    q[:1200] += 0.2
    plane = np.array([0.0, 0.0, 2.2])
    found = plane_kernels.trimmed(plane, x, y, q, (0.03, 0.008, 0.004), 50)
    design = np.stack([x, y, np.ones_like(x)], axis=1)
    for band_m in (0.03, 0.008, 0.004):
        near = np.abs((1.0 - (design @ plane) / q) / np.linalg.norm(plane)) < band_m
        plane = np.linalg.lstsq(design[near], q[near], rcond=None)[0]
    np.testing.assert_allclose(found, plane, rtol=0, atol=1e-12)
    assert not plane_kernels.trimmed(plane, x[:40], y[:40], q[:40], (0.03,), 50).any(), "too few fix no plane"


def test_planes_go_through_their_three_samples(rng: np.random.Generator) -> None:
    """As `np.linalg.solve` finds them; three samples in a line fix none and are left out."""
    (x, y), q = rng.uniform(-0.5, 0.5, (2, 60)), rng.uniform(2.0, 3.0, 60)
    triples = rng.permuted(np.tile(np.arange(60), (30, 1)), axis=1)[:, :3]
    x[triples[4]], y[triples[4]] = (0.1, 0.2, 0.3), (0.2, 0.4, 0.6)
    rows = np.stack([x[triples], y[triples], np.ones(triples.shape)], axis=2)
    clear = np.abs(np.linalg.det(rows)) >= 1e-3
    plain = np.linalg.solve(rows[clear], q[triples[clear]][:, :, None])[:, :, 0]
    found = plane_kernels.planes_through(triples, x, y, q, 1e-3)
    assert not clear[4]
    np.testing.assert_allclose(found, plain, rtol=1e-10, atol=1e-10)


def test_heights_over_a_plane_and_what_supports_it(rng: np.random.Generator) -> None:
    (x, y), q = rng.uniform(-0.5, 0.5, (2, 500)), rng.uniform(2.0, 2.2, 500)
    plane = np.array([0.1, -0.05, 2.1])
    plain = (1.0 - (x * plane[0] + y * plane[1] + plane[2]) / q) / np.linalg.norm(plane)
    heights = plane_kernels.heights_over(plane, x, y, q)
    np.testing.assert_allclose(heights, plain, rtol=0, atol=1e-15)
    near = np.abs(heights) < 0.004
    count, squares = plane_kernels.support(heights, 0.004)
    assert count == near.sum() > 0
    assert squares == pytest.approx(float(np.sum(heights[near] ** 2)), rel=1e-12)


def test_far_samples_stand_for_their_cells(rng: np.random.Generator) -> None:
    (x, y), q = rng.uniform(-0.5, 0.5, (2, 900)), rng.integers(1, 9, 900) / 4
    plain = []
    for cell in sorted(set(zip(np.rint(x * 10), np.rint(y * 10), strict=True))):
        here = np.flatnonzero((np.rint(x * 10) == cell[0]) & (np.rint(y * 10) == cell[1]))
        if len(here) >= plane_kernels.LEAST_OF_CELL:
            plain.append(here[np.argsort(q[here], kind="stable")[int(len(here) * 0.15)]])
    np.testing.assert_array_equal(plane_kernels.far_samples(x, y, q, 0.15), plain)


def test_rows_of_samples_have_the_means_of_their_near_ones(rng: np.random.Generator) -> None:
    along = np.repeat(np.arange(9) / 7.0, rng.integers(0, 30, 9))
    height = rng.normal(0.0, 0.004, len(along))
    near = np.abs(height) < 0.004
    rows = [height[near & (along == row)] for row in np.unique(along)]
    plain = [np.cumsum(row)[-1] / len(row) for row in rows if len(row) >= 12]
    np.testing.assert_array_equal(plane_kernels.row_means(along, height, 0.004, 12), plain)


@pytest.mark.parametrize("n", [1, 2, 12, 57])
def test_a_quantile_is_that_of_numpy(n: int) -> None:
    values = np.random.default_rng(n).normal(size=n)
    for share in (0.0, 0.25, 0.3, 0.77, 1.0):
        assert plane_kernels.quantile(values, share) == np.quantile(values, share)


def test_samples_are_the_pixels_with_depth(rng: np.random.Generator) -> None:
    grid = rng.integers(0, 3, SHAPE).astype(np.uint16)
    x, y, q = plane_kernels.samples_of(grid, 0.001, (600.0, 610.0, 20.5, 15.5), 4, 8)
    rows, columns = np.nonzero(grid)
    np.testing.assert_array_equal(x, (columns * 8 + 4 - 20.5) / 600.0)
    np.testing.assert_array_equal(y, (rows * 8 + 4 - 15.5) / 610.0)
    np.testing.assert_array_equal(q, 1.0 / (grid[rows, columns].astype(np.float64) * 0.001))


@pytest.mark.parametrize("columns", [43, 48])
def test_gaps_are_closed_with_their_lower_side(rng: np.random.Generator, columns: int) -> None:
    """Cell by cell: runs along rows first, then those along columns; longer ones stay, and those without an end."""
    seen = (np.convolve(rng.random(31 * columns), np.ones(3) / 3, "same") > 0.45).astype(np.uint8).reshape(31, columns)
    height = np.where(seen, rng.uniform(0, 60, seen.shape), 0).astype(np.float32)
    closed, plain = height.copy(), height.copy()
    heights._close_gaps(closed, seen, 4)
    for image, mask in ((plain, seen), (plain.T, seen.T)):
        for row, own in zip(image, mask, strict=True):
            places = np.flatnonzero(own)
            for first, last in itertools.pairwise(places):
                if 1 < last - first <= 5:
                    low = min(row[first], row[last])
                    row[first + 1 : last] = np.maximum(row[first + 1 : last], low)
    assert (closed != height).any()
    np.testing.assert_array_equal(closed, plain)


def test_a_median_is_that_of_the_library() -> None:
    for n in range(1, 17):
        values = [random.Random(n * 31 + k).uniform(0, 1) for k in range(n)]
        assert middle(list(values)) == statistics.median(values)


def test_what_outlines_lose_is_the_median_of_all_directions(rng: np.random.Generator) -> None:
    said = [
        Comparison(tuple(rng.normal(0, 2, n).tolist()), float(rng.normal(0, 0.1)), float(rng.uniform(800, 1200)), None)
        for n in (3, 0, 5, 4)
    ]
    for farther in (0.0, 0.013):
        plain = [px + farther * (abs(one.apart_m) * one.px_per_m) for one in said for px in one.lost_px]
        assert _lost_px(said, farther) == statistics.median(plain)


@pytest.mark.parametrize("seed", range(4))
def test_a_travel_history_answers_as_if_it_looked_at_all_frames(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A belt that stops and runs back, and more frames than are kept."""
    monkeypatch.setattr(history, "KEPT_FRAMES", 40)
    draw, kept = random.Random(seed), TravelHistory()
    ns, travel_m = 0, 0.0
    for n in range(200):
        ns, travel_m = ns + draw.randint(1, 60), travel_m + draw.choice([0, 0.0004, 0.01, 0.02, -0.015])
        kept.step(ns, travel_m)
        if n == 30:
            kept.shift(0.05)
            travel_m += 0.05
        times, reached = kept._times, np.maximum.accumulate([x for _, x in kept._times]).tolist()
        assert len(times) <= 40
        asked_m, wide_m = travel_m - draw.uniform(-0.1, 0.3), draw.uniform(0, 0.2)
        assert kept.frames_between(asked_m, asked_m + wide_m) == sum(
            asked_m <= x <= asked_m + wide_m for x in kept._moved
        )
        at = bisect_left(reached, asked_m)
        if at in (0, len(times)):
            assert kept.ns_at(asked_m) == times[max(0, at - 1)][0]
        else:
            assert times[at - 1][0] <= kept.ns_at(asked_m) <= times[at][0]


def test_views_are_wanted_before_their_track_is_decided() -> None:
    assert slot_offsets(3, half_view_m=0.25, decide_m=0.075) == (0.0, -0.06, 0.06)
    assert slot_offsets(3, half_view_m=0.25, decide_m=0.040) == (0.0, -0.06, 0.025)
