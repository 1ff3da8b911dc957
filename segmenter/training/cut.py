"""Bodies of simulated belts with their observations, cut as the running segmenter cuts them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from segmenter.classify.patch import COARSEST_MM, observe_instance
from segmenter.frame.heights import HeightMap, height_map
from segmenter.frame.instances import Instances, SplitSettings, split
from segmenter.frame.sides import with_own_centres
from segmenter.track.constants import ODD_AREA
from segmenter.track.track import trusted
from segmenter.training.pack import LabelledFrame, pack_frames
from segmenter.training.samples import TrainingSample, sample_of

MOSTLY = 0.7
"""Of an instance's cells that one body must have for the instance to stand for it."""
LEAST_AREA_M2, LEAST_HEIGHT_M = 450e-6, 0.018

Seen = tuple[LabelledFrame, HeightMap, Instances, int]
"""A body in a frame, and which instance of the frame it is."""


def cut_pack(folder: Path, *, on_shard: Callable[[int, int], None] = lambda done, total: None) -> list[TrainingSample]:
    """The bodies of all belts of a pack.

    Raises:
        InputError: there is no pack, or a shard cannot be read.
    """
    by_belt = groupby(pack_frames(folder, on_shard=on_shard), key=lambda frame: frame.belt_number)
    return [sample for _, frames in by_belt for sample in cut_belt(frames)]


def cut_belt(frames: Iterable[LabelledFrame]) -> list[TrainingSample]:
    """All bodies in the frames of one belt that the splitter finds large enough to be counted."""
    seen: dict[int, list[Seen]] = defaultdict(list)
    settings = SplitSettings()
    for frame in frames:
        heights = height_map(
            frame.depth, depth_scale_m=frame.depth_scale_m, belt=frame.belt, pixel_mm=settings.pixel_mm
        )
        instances = split(heights, frame.belt, settings)
        instances = with_own_centres(instances, frame.belt)
        for index, body in enumerate(_bodies(frame, heights, instances)):
            if body > 0 and not instances.cut[index, :2].any():
                seen[body].append((frame, heights, instances, index))
    return [_sample(body, seen[body]) for body in sorted(seen)]


def _sample(body: int, seen: list[Seen]) -> TrainingSample:
    """A body's observations without those whose area the tracker would find odd."""
    areas = np.array([instances.area_m2[index] for _, _, instances, index in seen])
    usual = float(np.median(areas))
    kept = [one for one, area in zip(seen, areas, strict=True) if max(area / usual, usual / area) <= ODD_AREA] or seen
    places = _steadied(np.array([instances.centre_m[i] - (frame.travel_m, 0) for frame, _, instances, i in kept]))
    observations = [
        observe_instance(heights, instances, index, frame.belt, x_m=x_m + frame.travel_m, y_m=y_m)
        for (frame, heights, instances, index), (x_m, y_m) in zip(kept, places.tolist(), strict=True)
    ]
    return sample_of(observations, kept[0][0].kinds[body - 1])


def _steadied(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) where the tracker takes a body to be after each of its n readings."""
    taken, trust = places.copy(), 1.0
    for n in range(1, len(places)):
        trust = trusted(trust, 1.0)
        taken[n] = taken[n - 1] + (places[n] - taken[n - 1]) / trust
    return taken


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
        large = instances.area_m2[index] >= LEAST_AREA_M2 and instances.height_m[index] >= LEAST_HEIGHT_M
        bodies.append(body if clear and large else 0)
    return bodies
