"""What rides along and is no tuber: clods, stones, haulm and leaves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from camera_sim.sim.meshes import Faces, Vertices, icosphere, random_rotation
from camera_sim.sim.tubers import smooth_relief

Mesh = tuple[Vertices, Faces]


def clod(rng: Generator) -> Mesh:
    """A lump of soil, 20 to 70 mm: rough at every scale, no smooth skin. Sizes are invented, not measured."""
    directions, faces = icosphere(3)
    coarse = smooth_relief(rng, directions, rms=0.09, finest=16)
    radius = 1 + coarse + smooth_relief(rng, directions, rms=0.05, finest=30)
    half_m = rng.uniform(0.010, 0.035) * rng.uniform(0.65, 1.0, 3)
    return directions * np.maximum(radius, 0.4)[:, None] * half_m @ random_rotation(rng).T, faces


def stone(rng: Generator) -> Mesh:
    """A stone, 20 to 80 mm: an ellipsoid with flat faces broken off."""
    directions, faces = icosphere(3)
    radius = np.ones(len(directions))
    for _ in range(int(rng.integers(4, 9))):
        normal = rng.standard_normal(3)
        along = directions @ (normal / np.linalg.norm(normal))
        radius = np.minimum(radius, np.where(along > 0.05, rng.uniform(0.55, 0.9) / np.maximum(along, 0.05), 9.0))
    half_m = rng.uniform(0.012, 0.04) * rng.uniform(0.6, 1.0, 3)
    return directions * radius[:, None] * half_m @ random_rotation(rng).T, faces


def haulm(rng: Generator) -> Mesh:
    """A stalk: a bent tube of 2 to 4 mm radius and 80 to 300 mm length."""
    rings, sides = 24, 8
    length_m, radius_m = rng.uniform(0.08, 0.30), rng.uniform(0.002, 0.004)
    along = np.linspace(-0.5, 0.5, rings)
    bend = rng.uniform(-0.5, 0.5) * (along**2) + rng.uniform(-0.3, 0.3) * along**3
    spine = np.stack([along * length_m, bend * length_m, 0.004 * np.abs(np.sin(6 * along + rng.uniform(0, 6)))], axis=1)
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    ring = np.stack([np.zeros(sides), np.cos(angle), np.sin(angle)], axis=1) * radius_m
    taper = np.sqrt(np.clip(1 - (2 * along) ** 8, 0.05, 1))
    vertices = (spine[:, None] + ring[None] * taper[:, None, None]).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij")
    a, b = (i * sides + j).ravel(), (i * sides + (j + 1) % sides).ravel()
    faces = np.concatenate([np.stack([a, b, a + sides], 1), np.stack([b, b + sides, a + sides], 1)]).astype(np.int32)
    return vertices, faces


def leaf(rng: Generator) -> Mesh:
    """A wilted leaf: a thin curled sheet of 20 to 60 mm."""
    directions, faces = icosphere(3)
    half_m = np.array([rng.uniform(0.012, 0.03), rng.uniform(0.008, 0.02), 0.0008])
    vertices = directions * half_m
    vertices[:, 2] += rng.uniform(-8, 8) * vertices[:, 0] ** 2 + rng.uniform(-8, 8) * vertices[:, 1] ** 2
    return vertices, faces


KINDS: dict[str, Callable[[Generator], Mesh]] = {"clod": clod, "stone": stone, "haulm": haulm, "leaf": leaf}


def draw_distractor(rng: Generator) -> tuple[str, Mesh]:
    """(kind, mesh); half of them clods."""
    kind = str(rng.choice(np.array(list(KINDS)), p=[0.5, 0.2, 0.2, 0.1]))
    return kind, KINDS[kind](rng)
