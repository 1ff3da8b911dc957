"""Portraits of simulated bodies with what they are: each body's looks, cut as the running segmenter cuts them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from segmenter.heights import HeightMap, height_map
from segmenter.instances import Instances, SplitSettings, split
from segmenter.learn.pack import LabelledFrame, pack_frames
from segmenter.portrait import COARSEST_MM, SIZE, Look, Portrait, take_look
from segmenter.sides import completed_centres

MOSTLY = 0.7
"""Of an instance's cells that one body must have for the instance to stand for it."""
LEAST_AREA_MM2, LEAST_HEIGHT_MM = 450.0, 18.0
WHITE_MM, STUCK_MM = 2.0, 0.8


@dataclass(frozen=True, slots=True)
class Sitter:
    """One body: (looks, 48, 48) heights in mm, whether seen, shares inside (see `Look`), and what it is."""

    heights_mm: NDArray[np.float16]
    seen: NDArray[np.uint8]
    inside: NDArray[np.float16]
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
    looks: dict[tuple[int, int], list[Look]] = defaultdict(list)
    kinds: dict[tuple[int, int], str] = {}
    settings = SplitSettings()
    for frame in pack_frames(folder, on_shard=on_shard):
        heights = height_map(
            frame.depth, depth_scale_m=frame.depth_scale_m, belt=frame.belt, pixel_mm=settings.pixel_mm
        )
        instances = split(heights, frame.belt, settings)
        instances = replace(instances, centre_m=completed_centres(instances, frame.belt))
        for index, body in enumerate(_bodies(frame, heights, instances)):
            if body > 0 and not instances.cut[index, :2].any():
                key = (frame.belt_number, body)
                looks[key].append(take_look(heights, instances, index, frame.belt))
                kinds[key] = frame.kinds[body - 1]
    return [
        Sitter(
            np.stack([look.height_mm for look in of_body]).astype(np.float16),
            np.stack([look.seen for look in of_body]).astype(np.uint8),
            np.stack([look.inside for look in of_body]).astype(np.float16),
            kinds[key],
        )
        for key, of_body in sorted(looks.items())
    ]


def draw_portrait(sitter: Sitter, rng: Generator) -> NDArray[np.float32]:
    """(5, 48, 48) float32: some of a body's looks, turned and worsened at random."""
    count = len(sitter.heights_mm)
    chosen = rng.permutation(count)[: int(rng.integers(1, count + 1))]
    heights_mm = sitter.heights_mm[chosen].astype(np.float32)
    heights_mm = heights_mm * np.float32(rng.uniform(0.95, 1.05))
    if rng.random() < 0.3:
        white = rng.standard_normal(heights_mm.shape, dtype=np.float32)
        heights_mm = heights_mm + white * np.float32(rng.uniform(0, WHITE_MM) * rng.uniform(0.2, 1.0))
    if rng.random() < 0.3:
        heights_mm = heights_mm + _stuck(rng) * np.float32(rng.uniform(0, STUCK_MM))
    heights_mm = np.maximum(heights_mm + np.float32(rng.normal(0, 1.5)), 0)
    channels = _averaged(heights_mm, sitter.seen[chosen], sitter.inside[chosen])
    if rng.random() < 0.5:
        channels = channels[:, :, ::-1]
    return np.ascontiguousarray(np.rot90(channels, int(rng.integers(4)), (1, 2)))


def plain_portrait(sitter: Sitter) -> NDArray[np.float32]:
    """(5, 48, 48) float32: all of a body's looks."""
    return _averaged(sitter.heights_mm.astype(np.float32), sitter.seen, sitter.inside)


def _averaged(
    heights_mm: NDArray[np.float32], seen: NDArray[np.uint8], inside: NDArray[np.float16]
) -> NDArray[np.float32]:
    portrait = Portrait()
    for height, where, share in zip(heights_mm, seen.astype(np.float32), inside.astype(np.float32), strict=True):
        portrait.add(Look(height * where, where, share))
    return portrait.channels()


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
