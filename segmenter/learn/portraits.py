"""Portraits of simulated bodies with what they are: each body's looks, cut as the running segmenter cuts them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numba import njit
from numpy.random import Generator
from numpy.typing import NDArray

from segmenter.heights import HeightMap, height_map
from segmenter.instances import Instances, SplitSettings, split
from segmenter.learn.pack import HEIGHT_STEP_MM, LabelledFrame, pack_frames
from segmenter.portrait import COARSEST_MM, SIZE, Look, as_channels, take_look
from segmenter.sides import completed_centres
from segmenter.track import ODD_AREA

MOSTLY = 0.7
"""Of an instance's cells that one body must have for the instance to stand for it."""
LEAST_AREA_MM2, LEAST_HEIGHT_MM = 450.0, 18.0
FEWEST_DRAWN = 4
WHITE_MM, STUCK_MM = 2.0, 0.4


@dataclass(frozen=True, slots=True)
class Sitter:
    """One body: (looks, 48, 48) uint16 heights in 0.01 mm, uint8 whether seen, uint8 shares inside of 255 (see `Look`),
    in the order of the belt's travel, and what it is.
    """

    heights: NDArray[np.uint16]
    seen: NDArray[np.uint8]
    inside: NDArray[np.uint8]
    kind: str

    @property
    def is_tuber(self) -> bool:
        """A tuber, no clod, stone or haulm."""
        return self.kind == "tuber"


def load_sitters(folder: Path, *, on_shard: Callable[[int, int], None] = lambda done, total: None) -> list[Sitter]:
    """All bodies of a pack that the splitter found large enough to be counted.

    Raises:
        InputError: there is no pack, or a shard cannot be read.
    """
    looks: dict[tuple[int, int], list[tuple[float, Look]]] = defaultdict(list)
    kinds: dict[tuple[int, int], str] = {}
    sitters: list[Sitter] = []
    settings = SplitSettings()

    def collect(done: int, total: int) -> None:
        sitters.extend(_sitter(looks[key], kinds[key]) for key in sorted(looks))
        looks.clear()
        on_shard(done, total)

    for frame in pack_frames(folder, on_shard=collect):
        heights = height_map(
            frame.depth, depth_scale_m=frame.depth_scale_m, belt=frame.belt, pixel_mm=settings.pixel_mm
        )
        instances = split(heights, frame.belt, settings)
        instances = replace(instances, centre_m=completed_centres(instances, frame.belt))
        for index, body in enumerate(_bodies(frame, heights, instances)):
            if body > 0 and not instances.cut[index, :2].any():
                key = (frame.belt_number, body)
                looks[key].append((float(instances.area_mm2[index]), take_look(heights, instances, index, frame.belt)))
                kinds[key] = frame.kinds[body - 1]
    return sitters


def _sitter(seen: list[tuple[float, Look]], kind: str) -> Sitter:
    """A body's looks but for those at whose area the tracker would take offence."""
    usual_mm2 = float(np.median([area for area, _ in seen]))
    kept = [look for area, look in seen if max(area / usual_mm2, usual_mm2 / area) <= ODD_AREA]
    kept = kept or [look for _, look in seen]
    return Sitter(
        np.stack([np.clip(look.height_mm / HEIGHT_STEP_MM + 0.5, 0, 65535) for look in kept]).astype(np.uint16),
        np.stack([look.seen for look in kept]).astype(np.uint8),
        np.stack([look.inside * 255 + 0.5 for look in kept]).astype(np.uint8),
        kind,
    )


def draw_portrait(sitter: Sitter, rng: Generator) -> NDArray[np.float32]:
    """(8, 48, 48) float32: some of a body's looks, turned and worsened at random."""
    height, square, seen, inside, looks = _summed(sitter, _drawn(len(sitter.heights), rng))
    count = np.maximum(seen, np.float32(1))
    scale = np.float32(rng.uniform(0.97, 1.03))
    mean, variance = height / count * scale, np.maximum(square / count - (height / count) ** 2, 0) * scale * scale
    if rng.random() < 0.25:
        white_mm = np.float32(rng.uniform(0, WHITE_MM) * rng.uniform(0.2, 1.0))
        mean = mean + white_mm / np.sqrt(count) * rng.standard_normal(mean.shape, dtype=np.float32)
        variance = variance + white_mm * white_mm * (1 - 1 / count)
    if rng.random() < 0.2:
        mean = mean + _stuck(rng) * np.float32(rng.uniform(0, STUCK_MM))
    mean = np.maximum(mean + np.float32(rng.normal(0, 1.0)), 0) * (seen > 0)
    sums = (mean * seen).astype(np.float32), ((variance + mean * mean) * seen).astype(np.float32)
    channels = as_channels(*sums, seen, inside, looks=looks)
    if rng.random() < 0.5:
        channels = channels[:, :, ::-1]
    return np.ascontiguousarray(np.rot90(channels, int(rng.integers(4)), (1, 2)))


def plain_portrait(sitter: Sitter) -> NDArray[np.float32]:
    """(8, 48, 48) float32: all of a body's looks."""
    height, square, seen, inside, looks = _summed(sitter, np.arange(len(sitter.heights)))
    return as_channels(height, square, seen, inside, looks=looks)


def _drawn(count: int, rng: Generator) -> NDArray[np.int64]:
    """Which looks are taken: a line judges when a track crosses the centre row, so mostly those from one side."""
    first, last = 0, count
    if rng.random() < 0.6:
        length = max(1, round(count * rng.uniform(0.45, 1.0)))
        first = 0 if rng.random() < 0.5 else count - length
        last = first + length
    fewest = min(FEWEST_DRAWN, last - first)
    taken = max(fewest, round((last - first) * float(np.sqrt(rng.random()))))
    return first + rng.permutation(last - first)[:taken]


def _summed(
    sitter: Sitter, chosen: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], int]:
    """Sums over the chosen looks as a `Portrait` keeps them, and how many looks they are."""
    return (*_sums(sitter.heights, sitter.seen, sitter.inside, chosen, HEIGHT_STEP_MM), len(chosen))


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _sums(
    heights: NDArray[np.uint16],
    seen: NDArray[np.uint8],
    inside: NDArray[np.uint8],
    chosen: NDArray[np.int64],
    step_mm: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Height, its square, seen and inside, each (48, 48), summed over looks."""
    sums = np.zeros((4, SIZE, SIZE), np.float32)
    for n in chosen:
        for i in range(SIZE):
            for j in range(SIZE):
                if seen[n, i, j]:
                    height_mm = heights[n, i, j] * step_mm
                    sums[0, i, j] += height_mm
                    sums[1, i, j] += height_mm * height_mm
                    sums[2, i, j] += 1
                    sums[3, i, j] += inside[n, i, j] / 255.0
    return sums[0], sums[1], sums[2], sums[3]


def _stuck(rng: Generator) -> NDArray[np.float32]:
    """Noise that is the same in all looks, as a camera has where its error follows the texture."""
    noise = cv2.GaussianBlur(rng.standard_normal((SIZE, SIZE), dtype=np.float32), (0, 0), rng.uniform(0.8, 4.0))
    return np.asarray(noise / noise.std(), np.float32)


def _bodies(frame: LabelledFrame, heights: HeightMap, instances: Instances) -> list[int]:
    """Number of the body that each instance stands for; 0 where it is small, low, unclear or too coarse to see."""
    if heights.cell_mm > COARSEST_MM:
        return [0] * len(instances)
    stride = heights.stride
    rows, columns = instances.labels.shape
    half = stride // 2
    truth = frame.labels[half : rows * stride : stride, half : columns * stride : stride].astype(np.int64)
    most = int(truth.max()) + 1
    shared = np.bincount(
        instances.labels.astype(np.int64).ravel() * most + truth.ravel(), minlength=(len(instances) + 1) * most
    ).reshape(-1, most)
    bodies = []
    for index in range(len(instances)):
        counts = shared[index + 1]
        body = int(counts.argmax())
        clear = counts[body] >= MOSTLY * counts.sum()
        large = instances.area_mm2[index] >= LEAST_AREA_MM2 and instances.height_mm[index] >= LEAST_HEIGHT_MM
        bodies.append(body if clear and large else 0)
    return bodies
