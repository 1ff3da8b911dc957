"""How a tuber lies: at rest on its support, or in any orientation (pushed, leaning, tumbling over cleats)."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from camera_sim.sim.meshes import Vertices, icosphere, neighbours, random_rotation, rotation_about, rotation_taking

_DOWN = np.array([0.0, 0.0, -1.0])
_LEVEL = 2


def free_rotation(rng: Generator) -> Vertices:
    """(3, 3) any orientation, equally likely."""
    return random_rotation(rng)


def resting_rotation(vertices: Vertices, rng: Generator, *, patience_m: float = 0.002) -> Vertices:
    """(3, 3) a stable pose with random heading.

    Stable poses are the local minima of the support height h(d) = max over vertices of v.d over directions d; which one
    is taken follows the share of directions that roll into it, less likely by exp(-(h - lowest) / `patience_m`).
    Agrees within 2.4 mm of height with a physics engine (facts of the feasibility study).
    """
    directions, _ = icosphere(_LEVEL)
    near = neighbours(_LEVEL)
    height = (vertices[::3] @ directions.T).max(axis=0)
    lowest = float(height.min())
    while True:
        at = int(rng.integers(len(directions)))
        while True:
            best = int(near[at][np.argmin(height[near[at]])])
            if height[best] >= height[at]:
                break
            at = best
        if rng.random() < np.exp(-(height[at] - lowest) / patience_m):
            break
    heading = rotation_about(np.array([0.0, 0.0, 1.0]), float(rng.uniform(0, 2 * np.pi)))
    return np.asarray(heading @ rotation_taking(directions[at], _DOWN))


def rest_on_belt(vertices: Vertices, rotation: Vertices) -> Vertices:
    """(V, 3) metres, rotated, lowest point at z = 0, box centred on x = y = 0."""
    turned = vertices @ rotation.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    return np.asarray(turned - np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]))
