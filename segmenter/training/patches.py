"""Patches drawn from a body's observations, worsened as belts and cameras differ."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from conveyor.kernels import kernel
from segmenter.classify.patch import SIZE, as_channels
from segmenter.training.pack import HEIGHT_STEP_MM
from segmenter.training.samples import INSIDE_BIT, TrainingSample

FEWEST_DRAWN = 4
WHITE_MM = 2.0
STUCK_SHARE, STUCK_MM, STUCK_CELLS = 0.5, (0.1, 1.6), (0.8, 4.0)
"""Noise that stays where it is on a body from frame to frame, as a stereo camera's does, for it follows the texture:
OpenCV's matcher leaves 0.5 to 1.1 mm on tubers 0.35 to 0.46 m away, smooth over 1.3 cells (`benchmarks matched`)."""
STUCK_SPREAD = (0.25, 1.0)
"""Of the spread over observations is left before such a camera: its errors are not drawn afresh in each frame."""
STUCK_ON_BELT = 0.4
"""Of that noise lies on the flat belt around."""

Sums = tuple[NDArray[np.float32], int]


def draw_patches(samples: list[TrainingSample], rng: Generator) -> NDArray[np.float32]:
    """(n, 10, 48, 48) float32: of each body some of its observations, turned and worsened at random."""
    sums = [
        _worsened(_sums(s.observations, _drawn(len(s.observations), rng), HEIGHT_STEP_MM, INSIDE_BIT), rng)
        for s in samples
    ]
    channels = _channels(sums)
    for n in range(len(channels)):
        side = channels[n, :, ::-1] if rng.random() < 0.5 else channels[n]
        channels[n] = np.rot90(side, int(rng.integers(4)), (1, 2)).copy()
    return channels


def plain_patches(samples: list[TrainingSample]) -> NDArray[np.float32]:
    """(n, 10, 48, 48) float32: of each body all its observations."""
    return _channels(
        [_sums(s.observations, np.arange(len(s.observations)), HEIGHT_STEP_MM, INSIDE_BIT) for s in samples]
    )


def _channels(sums: list[Sums]) -> NDArray[np.float32]:
    images = np.stack([one[0] for one in sums])
    observations = np.array([one[1] for one in sums], np.float32)
    return as_channels(images[:, 0], images[:, 1], images[:, 2], images[:, 3], observations=observations)


def _worsened(sums: Sums, rng: Generator) -> Sums:
    """The sums as another camera would have made them: its scale, its noise, its belt's height."""
    (height, square, seen, inside), observations = sums
    count = np.maximum(seen, np.float32(1))
    scale = np.float32(rng.uniform(0.97, 1.03))
    mean, variance = height / count * scale, np.maximum(square / count - (height / count) ** 2, 0) * scale * scale
    if rng.random() < 0.25:
        white_mm = np.float32(rng.uniform(0, WHITE_MM) * rng.uniform(0.2, 1.0))
        mean = mean + white_mm / np.sqrt(count) * rng.standard_normal(mean.shape, dtype=np.float32)
        variance = variance + white_mm * white_mm * (1 - 1 / count)
    if rng.random() < STUCK_SHARE:
        on_body = np.where(2 * inside > count, np.float32(1), np.float32(STUCK_ON_BELT))
        mean = mean + _stuck(rng) * on_body * np.float32(_between(*STUCK_MM, rng))
        variance = variance * np.float32(_between(*STUCK_SPREAD, rng) ** 2)
    mean = np.maximum(mean + np.float32(rng.normal(0, 1.0)), 0) * (seen > 0)
    return np.stack([mean * seen, (variance + mean * mean) * seen, seen, inside]), observations


def _drawn(count: int, rng: Generator) -> NDArray[np.int64]:
    """Which observations are taken: mostly from one side, for a line classifies when a track crosses the centre row."""
    first, last = 0, count
    if rng.random() < 0.6:
        length = max(1, round(count * rng.uniform(0.45, 1.0)))
        first = 0 if rng.random() < 0.5 else count - length
        last = first + length
    fewest = min(FEWEST_DRAWN, last - first)
    taken = max(fewest, round((last - first) * float(np.sqrt(rng.random()))))
    return first + rng.permutation(last - first)[:taken]


@kernel()
def _sums(observations: NDArray[np.uint16], chosen: NDArray[np.int64], step_mm: float, inside_bit: np.uint16) -> Sums:
    """(4, 48, 48) height, its square, seen and inside, summed over the chosen observations as a `Patch` keeps them.

    Returns them with the number of observations.
    """
    sums = np.zeros((4, SIZE, SIZE), np.float32)
    for n in chosen:
        for i in range(SIZE):
            for j in range(SIZE):
                cell = observations[n, i, j]
                steps = cell & ~inside_bit
                if steps:
                    height_mm = (steps - 1) * step_mm
                    sums[0, i, j] += height_mm
                    sums[1, i, j] += height_mm * height_mm
                    sums[2, i, j] += 1
                    sums[3, i, j] += cell >= inside_bit
    return sums, len(chosen)


def _stuck(rng: Generator) -> NDArray[np.float32]:
    """(48, 48) noise that is the same in all observations, with sd 1."""
    noise = cv2.GaussianBlur(rng.standard_normal((SIZE, SIZE), dtype=np.float32), (0, 0), _between(*STUCK_CELLS, rng))
    return np.asarray(noise / noise.std(), np.float32)


def _between(low: float, high: float, rng: Generator) -> float:
    """Drawn evenly in the logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
