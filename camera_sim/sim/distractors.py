"""What rides along and is no tuber: clods, stones, haulm and leaves. Shapes and sizes are invented, not measured."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from camera_sim.sim.meshes import Faces, Vertices, icosphere, random_rotation
from camera_sim.sim.tubers import smooth_relief

Mesh = tuple[Vertices, Faces]
HALF_M = (0.010, 0.042)
"""Longest half axis of clods and stones, metres: from crumbs to the size of a large tuber."""
HARD_NEGATIVE_HALF_M = (0.015, 0.046)
FINE_RMS, WORN_RMS = (0.03, 0.07), (0.0, 0.03)
"""Fine roughness of a clod, as a share of its radius, and of one that was rained on or rolled about."""
DENSITY_G_ML = {"clod": 1.6, "stone": 2.6, "haulm": 0.5, "leaf": 0.5}
"""Of what is simulated, by kind: moist loam, rock, wilted stalks."""
LUMP_FALL, LUMP_RMS, LUMP_FINEST = (0.5, 1.2), (0.06, 0.12), (7.0, 15.0)
"""Relief of a clod without any fine roughness: how fast it falls off, its share of the radius, its finest waves."""


def clod(rng: Generator, *, longest_m: tuple[float, float] = HALF_M, fine_rms: tuple[float, float] = FINE_RMS) -> Mesh:
    """A lump of soil: rough at every scale, no smooth skin; one in three broken, with a few flat faces.

    Balls of mud as smooth as a tuber are left out: no depth camera tells them from one.
    """
    directions, faces = icosphere(3)
    coarse = smooth_relief(rng, directions, rms=rng.uniform(0.06, 0.13), finest=rng.uniform(10.0, 18.0))
    fine = smooth_relief(rng, directions, rms=rng.uniform(*fine_rms), finest=rng.uniform(22.0, 36.0))
    radius = np.ones(len(directions))
    if rng.random() < 1 / 3:
        radius = _cut(rng, directions, faces_cut=int(rng.integers(1, 5)), worn=rng.uniform(0.0, 0.05))
    return _sized(rng, directions, radius + coarse + fine, longest_m=longest_m), faces


def lump(rng: Generator, *, longest_m: tuple[float, float] = HALF_M) -> Mesh:
    """A clod as smooth as a tuber, but of no tuber's shape: two to five times its relief."""
    directions, faces = icosphere(3)
    relief = smooth_relief(
        rng,
        directions,
        rms=rng.uniform(*LUMP_RMS),
        finest=rng.uniform(*LUMP_FINEST),
        fall=rng.uniform(*LUMP_FALL),
    )
    return _sized(rng, directions, 1 + relief, longest_m=longest_m), faces


def stone(rng: Generator, *, longest_m: tuple[float, float] = HALF_M) -> Mesh:
    """A stone: an ellipsoid with flat faces broken off, its edges sharp to somewhat worn; no round pebbles."""
    directions, faces = icosphere(3)
    radius = _cut(rng, directions, faces_cut=int(rng.integers(4, 10)), worn=rng.uniform(0.0, 0.05))
    radius = radius + smooth_relief(rng, directions, rms=rng.uniform(0.0, 0.02), finest=rng.uniform(8.0, 20.0))
    half_m = rng.uniform(*longest_m) * rng.uniform(0.55, 1.0, 3)
    return directions * radius[:, None] * half_m @ random_rotation(rng).T, faces


def _sized(
    rng: Generator, directions: Vertices, radius: NDArray[np.float64], *, longest_m: tuple[float, float]
) -> Vertices:
    """(V, 3) metres: the lump of that radius in each direction, as long as drawn, up to 40 % slimmer, lying anyhow."""
    half_m = rng.uniform(*longest_m) * rng.uniform(0.6, 1.0, 3)
    return np.asarray(directions * np.maximum(radius, 0.35)[:, None] * half_m @ random_rotation(rng).T)


def haulm(rng: Generator) -> Mesh:
    """A stalk of 2 to 4 mm radius; one in four is a wad of several shorter ones."""
    if rng.random() < 0.75:
        return _stalk(rng, length_m=rng.uniform(0.08, 0.30), radius_m=rng.uniform(0.002, 0.004))
    stalks = []
    for _ in range(int(rng.integers(3, 9))):
        vertices, faces = _stalk(rng, length_m=rng.uniform(0.05, 0.14), radius_m=rng.uniform(0.002, 0.004))
        moved = vertices @ random_rotation(rng).T * np.array([1.0, 1.0, 0.4]) + rng.normal(0, 0.010, 3)
        stalks.append((moved, faces))
    return _joined(stalks)


def leaf(rng: Generator) -> Mesh:
    """A wilted leaf: a thin curled sheet of 20 to 60 mm."""
    directions, faces = icosphere(3)
    half_m = np.array([rng.uniform(0.012, 0.03), rng.uniform(0.008, 0.02), 0.0008])
    vertices = directions * half_m
    vertices[:, 2] += rng.uniform(-8, 8) * vertices[:, 0] ** 2 + rng.uniform(-8, 8) * vertices[:, 1] ** 2
    return vertices, faces


def _cut(rng: Generator, directions: Vertices, *, faces_cut: int, worn: float) -> NDArray[np.float64]:
    """(V,) radius of the unit sphere with flat faces cut off; `worn` 0 leaves sharp edges, 0.05 rounds them."""
    closeness = np.ones(len(directions)) if worn <= 0.005 else np.full(len(directions), np.exp(1 / worn))
    for _ in range(faces_cut):
        normal = rng.standard_normal(3)
        along = directions @ (normal / np.linalg.norm(normal))
        inverse = np.maximum(along, 0.0) / rng.uniform(0.55, 0.9)
        closeness = np.maximum(closeness, inverse) if worn <= 0.005 else closeness + np.exp(inverse / worn)
    return 1 / closeness if worn <= 0.005 else 1 / (worn * np.log(closeness))


def _stalk(rng: Generator, *, length_m: float, radius_m: float) -> Mesh:
    """A bent tube along x."""
    rings, sides = 24, 8
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


def _joined(meshes: list[Mesh]) -> Mesh:
    """One mesh of several."""
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes[:-1]])
    faces = np.concatenate([faces + start for (_, faces), start in zip(meshes, starts.tolist(), strict=True)])
    return np.concatenate([vertices for vertices, _ in meshes]), faces.astype(np.int32)


KINDS: dict[str, Callable[[Generator], Mesh]] = {"clod": clod, "stone": stone, "haulm": haulm, "leaf": leaf}


def draw_distractor(rng: Generator) -> tuple[str, Mesh]:
    """(kind, mesh); half of them clods."""
    kind = str(rng.choice(np.array(list(KINDS)), p=[0.5, 0.2, 0.2, 0.1]))
    return kind, KINDS[kind](rng)


def draw_hard_negative(rng: Generator) -> tuple[str, Mesh]:
    """(kind, mesh) of what is hard to tell from a tuber: clods (one in four worn, one in four a smooth lump) and stones
    of a tuber's size, hardly any haulm.
    """
    kind = str(rng.choice(np.array(["clod", "stone", "haulm"]), p=[0.50, 0.44, 0.06]))
    if kind == "haulm":
        return kind, haulm(rng)
    if kind == "stone":
        return kind, stone(rng, longest_m=HARD_NEGATIVE_HALF_M)
    sort = rng.random()
    if sort < 1 / 4:
        return kind, lump(rng, longest_m=HARD_NEGATIVE_HALF_M)
    return kind, clod(rng, longest_m=HARD_NEGATIVE_HALF_M, fine_rms=WORN_RMS if sort < 1 / 2 else FINE_RMS)
