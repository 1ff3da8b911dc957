"""Tubers that rock, roll and slide a little while they ride, each about the place where it crosses the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from camera_sim.sim.meshes import Vertices, rotation_about

ROLLING_SHARE = 0.25
ROCK_RAD, SLIDE_M, ROLL_RAD_PER_M = 0.12, 0.003, 1.5
"""Standard deviations at strength 1. Invented, not measured: a rolling tuber turns by some 30 degrees in a view."""
FARTHEST_M = 0.35
"""Beyond this distance from the crossing a tuber lies still, so that a long recording heaps nothing up."""


@dataclass(frozen=True, slots=True)
class Drift:
    """A smooth motion over the belt that is nothing at all where the tuber crosses x = 0.

    Attributes:
        axis: (3,) unit vector in the belt's plane about which it turns.
        slide_m: (2,) how far it slides to and fro, along and across the belt.
        rock_rad: how far it rocks; roll_rad_per_m: how it rolls on, and moves by its radius times that angle.
        radius_m: half its height; wave_per_m, phase: of sliding and rocking over the belt's travel.
    """

    axis: NDArray[np.float64]
    slide_m: NDArray[np.float64]
    rock_rad: float
    roll_rad_per_m: float
    radius_m: float
    wave_per_m: float
    phase: float

    def offset_m(self, beyond_m: float) -> NDArray[np.float64]:
        """(2,) where its middle is, against where it crosses, when it is `beyond_m` past x = 0."""
        s = float(np.clip(beyond_m, -FARTHEST_M, FARTHEST_M))
        towards = np.array([self.axis[1], -self.axis[0]])  # turning about +y moves the top, and so the tuber, along +x
        rolled = towards * (self.radius_m * self.roll_rad_per_m * s)
        return np.asarray(rolled + self.slide_m * self._swing(s))

    def moved(self, vertices: Vertices, beyond_m: float) -> Vertices:
        """(V, 3) the vertices of a tuber that crosses as `vertices`, when it is `beyond_m` past x = 0."""
        s = float(np.clip(beyond_m, -FARTHEST_M, FARTHEST_M))
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        middle = (low + high) / 2
        turn = rotation_about(self.axis, self.rock_rad * self._swing(s) + self.roll_rad_per_m * s)
        turned = (vertices - middle) @ turn.T
        turned[:, :2] += middle[:2] + self.offset_m(beyond_m) - (turned.min(axis=0) + turned.max(axis=0))[:2] / 2
        turned[:, 2] += low[2] - turned[:, 2].min()
        return np.asarray(turned)

    def _swing(self, s: float) -> float:
        return float(np.sin(self.wave_per_m * s + self.phase) - np.sin(self.phase))


def draw_drift(rng: Generator, vertices: Vertices, *, strength: float) -> Drift:
    """How a tuber with these vertices moves; `strength` 1 is a belt that shakes."""
    heading = float(rng.uniform(0, 2 * np.pi))
    slide, rock, roll = rng.standard_normal(2), rng.standard_normal(), rng.standard_normal()
    rolls = rng.random() < ROLLING_SHARE
    return Drift(
        axis=np.array([np.cos(heading), np.sin(heading), 0.0]),
        slide_m=strength * SLIDE_M * np.clip(slide, -2, 2),
        rock_rad=strength * ROCK_RAD * float(np.clip(rock, -2, 2)),
        roll_rad_per_m=strength * ROLL_RAD_PER_M * float(np.clip(roll, -2, 2)) if rolls else 0.0,
        radius_m=float(np.ptp(vertices[:, 2])) / 2,
        wave_per_m=float(rng.uniform(15.0, 35.0)),
        phase=float(rng.uniform(0, 2 * np.pi)),
    )
