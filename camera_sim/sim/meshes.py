"""Triangle meshes on a subdivided icosahedron: directions, volume, orientation."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Vertices = NDArray[np.float64]
Faces = NDArray[np.int32]


@lru_cache(maxsize=8)
def icosphere(level: int) -> tuple[Vertices, Faces]:
    """Unit directions (V, 3) and outward faces (F, 3); 642 and 1280 of them at level 3, 2562 and 5120 at level 4."""
    golden = (1 + 5**0.5) / 2
    vertices: list[tuple[float, float, float]] = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0)]
    vertices += [(0, -1, golden), (0, 1, golden), (0, -1, -golden), (0, 1, -golden)]
    vertices += [(golden, 0, -1), (golden, 0, 1), (-golden, 0, -1), (-golden, 0, 1)]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2)]
    faces += [(10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11)]
    faces += [(6, 2, 10), (8, 6, 7), (9, 8, 1)]
    points = [np.asarray(v, float) / np.linalg.norm(v) for v in vertices]
    for _ in range(level):
        middles: dict[tuple[int, int], int] = {}
        finer: list[tuple[int, int, int]] = []
        for a, b, c in faces:
            ab, bc, ca = (_middle(points, middles, *edge) for edge in ((a, b), (b, c), (c, a)))
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    directions, triangles = np.array(points), np.array(faces, np.int32)
    directions.setflags(write=False)
    triangles.setflags(write=False)
    return directions, triangles


def _middle(points: list[Vertices], middles: dict[tuple[int, int], int], a: int, b: int) -> int:
    key = (min(a, b), max(a, b))
    if key not in middles:
        middle = points[a] + points[b]
        points.append(middle / np.linalg.norm(middle))
        middles[key] = len(points) - 1
    return middles[key]


@lru_cache(maxsize=8)
def neighbours(level: int) -> NDArray[np.int32]:
    """(V, 6) indices of each vertex' neighbours on the icosphere; the twelve of degree 5 name one twice."""
    directions, faces = icosphere(level)
    around: list[set[int]] = [set() for _ in directions]
    for a, b, c in faces.tolist():
        around[a] |= {b, c}
        around[b] |= {a, c}
        around[c] |= {a, b}
    return np.array([sorted(near) + [min(near)] * (6 - len(near)) for near in around], np.int32)


def volume(vertices: Vertices, faces: Faces) -> float:
    """Enclosed volume of a closed mesh with outward faces, in the vertices' unit cubed (divergence theorem)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.empty_like(b)
    cross[:, 0] = b[:, 1] * c[:, 2] - b[:, 2] * c[:, 1]
    cross[:, 1] = b[:, 2] * c[:, 0] - b[:, 0] * c[:, 2]
    cross[:, 2] = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
    return float(np.einsum("ij,ij->", a, cross)) / 6


def random_rotation(rng: Generator) -> Vertices:
    """(3, 3) rotation, uniform over all orientations (unit quaternion of normals)."""
    w, x, y, z = (q := rng.standard_normal(4)) / np.sqrt((q * q).sum())
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotation_about(axis: Vertices, angle_rad: float) -> Vertices:
    """(3, 3) rotation by `angle_rad` about the unit vector `axis` (Rodrigues)."""
    x, y, z = axis
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle_rad) * k + (1 - np.cos(angle_rad)) * (k @ k))


def rotation_taking(a: Vertices, b: Vertices) -> Vertices:
    """(3, 3) shortest rotation that takes unit vector a to unit vector b."""
    axis = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(axis)), float(a @ b)
    if sine < 1e-9:
        return np.eye(3) if cosine > 0 else rotation_about(_any_perpendicular(a), np.pi)
    return rotation_about(axis / sine, float(np.arctan2(sine, cosine)))


def _any_perpendicular(a: Vertices) -> Vertices:
    other = np.cross(a, np.array([1.0, 0.0, 0.0]) if abs(a[0]) < 0.9 else np.array([0.0, 1.0, 0.0]))
    return np.asarray(other / np.linalg.norm(other))
