"""Fresh augmentation of training clouds, for every epoch and every cloud.

The paper's: jitter of 0.5 mm, rotation by up to 2 degrees about each axis, flips in x and y, shear of 0.2. The
reference also lets the shear tilt and thicken a cloud without changing its height or its weight, and augments its
validation data; neither is the default here. Ours: full turns about the belt's normal (a belt has no direction),
stretch and shear in the belt's plane that keep the area and so the volume, and a change of scale that changes the
height with it and the weight with its cube.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from regressor.network.grouping import radius_is_free_of
from regressor.network.sampling import _farthest


@dataclass(frozen=True, slots=True)
class Augmentation:
    """How far a training cloud may be moved. Angles in degrees, lengths in metres, the rest are factors."""

    jitter_m: float = 5e-4
    tilt_deg: float = 2.0
    turn_deg: float = 180.0
    flip: bool = True
    plane_shear: float = 0.1
    shear: float = 0.0
    scale: float = 0.08
    height_sd_m: float = 0.0

    @classmethod
    def paper(cls) -> Augmentation:
        """As in the paper, fresh for every epoch."""
        return cls(jitter_m=5e-4, tilt_deg=2.0, turn_deg=2.0, flip=True, plane_shear=0.0, shear=0.2, scale=0.0)


def draw_matrices(
    rng: np.random.Generator, count: int, settings: Augmentation
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """((count, 3, 3) linear maps, (count,) scale factors s: height times s, weight times s cubed)."""
    angle = np.deg2rad(np.array([settings.tilt_deg, settings.tilt_deg, settings.turn_deg]))
    ax, ay, az = (rng.uniform(-1, 1, (count, 3)) * angle).T
    matrix = _about(2, az) @ _about(1, ay) @ _about(0, ax)
    if settings.plane_shear:
        stretch = np.exp(rng.normal(0.0, settings.plane_shear / 2, count))
        plane = np.tile(np.eye(3), (count, 1, 1))
        plane[:, 0, 0], plane[:, 1, 1] = stretch, 1 / stretch
        plane[:, 0, 1] = rng.uniform(-settings.plane_shear, settings.plane_shear, count)
        matrix = plane @ matrix
    if settings.shear:
        shear = rng.uniform(-settings.shear, settings.shear, (count, 3, 3))
        shear[:, range(3), range(3)] = 1.0
        matrix = shear @ matrix
    if settings.flip:
        matrix[:, 0] *= rng.choice([-1.0, 1.0], (count, 1))
        matrix[:, 1] *= rng.choice([-1.0, 1.0], (count, 1))
    scale = np.exp(rng.uniform(-1, 1, count) * np.log1p(settings.scale))
    return (matrix * scale[:, None, None]).astype(np.float32), scale


def _about(axis: int, angle: NDArray[np.float64]) -> NDArray[np.float64]:
    out = np.tile(np.eye(3), (len(angle), 1, 1))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out[:, a, a] = out[:, b, b] = np.cos(angle)
    out[:, b, a] = np.sin(angle)
    out[:, a, b] = -np.sin(angle)
    return out


def augmented_batch(
    points: NDArray[np.float32],
    height_m: NDArray[np.float64],
    weight_g: NDArray[np.float64],
    rng: np.random.Generator,
    settings: Augmentation,
    *,
    highest_m: float,
    count: int = 128,
    resample: bool = True,
    power: int = 3,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Moved and freshly sampled clouds.

    Args:
        points: (B, M, 3) centred, metres. height_m: (B,) not clamped. weight_g: (B,).
        highest_m: clamp of the height.
        count: points to sample; all M where a moved cloud is wider than the smaller search radius, whose centroids find
            neighbours of their own among them.
        resample: sample again from a random first point, with jitter; False takes the sampling of a prediction, which
            turns and flips leave as it is.
        power: of the scale that the target goes with: 3 for a weight or a volume, 1 for a length.

    Returns:
        ((B, count or M, 3) in sampling order, (B,) clamped heights, (B,) weights), all float32.
    """
    matrices, scale = draw_matrices(rng, len(points), settings)
    moved = points @ matrices.transpose(0, 2, 1)
    if settings.jitter_m and resample:
        moved = moved + rng.uniform(-settings.jitter_m, settings.jitter_m, moved.shape).astype(np.float32)
    height = height_m * scale
    if settings.height_sd_m:
        height = height + rng.normal(0.0, settings.height_sd_m, len(height))
    if not all(radius_is_free_of(cloud) for cloud in moved):
        count = points.shape[1]
    if not resample:
        sampled = np.ascontiguousarray(moved[:, :count])
    else:
        start = rng.integers(0, points.shape[1], len(points))
        sampled = _sample_batch(np.ascontiguousarray(moved.transpose(0, 2, 1)), start, count)
    return (
        sampled,
        np.clip(height, 0.0, highest_m).astype(np.float32),
        (weight_g * scale**power).astype(np.float32),
    )


@kernel(nogil=True)
def _sample_batch(columns: NDArray[np.float32], start: NDArray[np.int64], count: int) -> NDArray[np.float32]:
    out = np.empty((len(columns), count, 3), np.float32)
    for row in range(len(columns)):
        chosen = _farthest(columns[row], columns.shape[2], count, start[row])
        for i in range(count):
            for axis in range(3):
                out[row, i, axis] = columns[row, axis, chosen[i]]
    return out
