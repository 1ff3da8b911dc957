"""One tuber as a closed mesh: fuller than an ellipsoid, bumpy, bent, tapered, some with second growth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from camera_sim.sim.cultivars import ODD_STOCK, Recipe, Stock, draw_recipe
from camera_sim.sim.mesh_size import square_mesh_m
from camera_sim.sim.meshes import Faces, Vertices, icosphere, volume

LEVEL = 4
FULLNESS = (1.6, 3.2)
"""Allowed superellipsoid exponents: 2 is an ellipsoid, above 3.2 outlines look like boxes, below 1.6 like kites."""

ODD_FULLNESS = (1.7, 2.8)
ODD_WIDTH, ODD_DEPTH = (0.5, 1.0), (0.6, 1.0)
"""Of odd tubers: width over length, depth over width."""
ODD_WEIGHT_G = (20.0, 450.0)


@dataclass(frozen=True, slots=True)
class Tuber:
    """A tuber lying nowhere yet.

    Attributes:
        vertices: (V, 3) metres, its own frame: axes along x >= y >= z, bounding box centred on the origin.
        faces: (F, 3) outward.
        axes_mm: sorted caliper axes, the sides of that box.
        volume_ml, weight_g: of the mesh, and times the density drawn for it.
        bare: (V, 3) the tuber without its jacket of soil, where `vertices` have one; None: they have none.
    """

    vertices: Vertices
    faces: Faces
    axes_mm: tuple[float, float, float]
    volume_ml: float
    weight_g: float
    stock: Stock
    bare: Vertices | None = None

    @property
    def square_mesh_mm(self) -> float:
        """Side of the smallest square hole that it passes without its soil (`camera_sim.sim.mesh_size`)."""
        return 1000 * square_mesh_m(self.vertices if self.bare is None else self.bare)


@dataclass(frozen=True, slots=True)
class _Form:
    """Everything about a shape but its fullness: all of it is drawn once, then fullness is solved for."""

    relief: NDArray[np.float64]
    lobes: NDArray[np.float64]
    bend: float
    bend_side: float
    taper: float


def draw_tuber(rng: Generator, *, level: int = LEVEL, stock: Stock | None = None) -> Tuber:
    """A tuber of `stock`, or of any, from the real distributions, its fullness solved so that it has the drawn volume.

    Where no allowed fullness reaches that volume the nearest one is taken and all axes are scaled alike.
    """
    return grow(draw_recipe(rng, stock=stock), rng, level=level)


def grow(recipe: Recipe, rng: Generator, *, level: int = LEVEL) -> Tuber:
    """The mesh of `recipe`; `rng` decides on everything the recipe leaves open."""
    directions, faces = icosphere(level)
    form = _draw_form(recipe, rng, directions)
    half_m = np.asarray(recipe.axes_mm) / 2000
    low, high = FULLNESS
    for _ in range(12):
        middle = (low + high) / 2
        if volume(_shape(directions, form, middle, half_m), faces) * 1e6 < recipe.volume_ml:
            low = middle
        else:
            high = middle
    vertices = _shape(directions, form, (low + high) / 2, half_m)
    scale = (recipe.volume_ml / (volume(vertices, faces) * 1e6)) ** (1 / 3)
    vertices *= scale
    volume_ml = volume(vertices, faces) * 1e6
    length, width, depth = (scale * axis for axis in recipe.axes_mm)
    return Tuber(vertices, faces, (length, width, depth), volume_ml, volume_ml * recipe.density_g_ml, recipe.stock)


def draw_odd_tuber(rng: Generator, *, level: int = LEVEL) -> Tuber:
    """A tuber of no cultivar: any fullness, slimmer and flatter than real ones, half of them smooth and straight.

    Ellipsoids and boxes of other simulators are like these; weights are uniform in their logarithm.
    """
    directions, faces = icosphere(level)
    width, depth = rng.uniform(*ODD_WIDTH), rng.uniform(*ODD_DEPTH)
    half = np.array([1.0, width, width * depth])
    density = ODD_STOCK.density_g_ml[0] + ODD_STOCK.density_g_ml[1] * float(np.clip(rng.standard_normal(), -2.5, 2.5))
    weight_g = float(np.exp(rng.uniform(*np.log(ODD_WEIGHT_G))))
    recipe = Recipe(ODD_STOCK, (2.0, 2 * width, 2 * width * depth), weight_g / density, density, 0.0)
    form = _draw_form(recipe, rng, directions)
    if rng.random() < 0.5:
        form = _Form(np.zeros(len(directions)), form.lobes, 0.0, 0.0, 0.0)
    vertices = _shape(directions, form, float(rng.uniform(*ODD_FULLNESS)), half)
    vertices *= (recipe.volume_ml * 1e-6 / volume(vertices, faces)) ** (1 / 3)
    length, width_mm, depth_mm = (float(1000 * extent) for extent in np.ptp(vertices, axis=0))
    return Tuber(vertices, faces, (length, width_mm, depth_mm), recipe.volume_ml, weight_g, ODD_STOCK)


def with_jacket(tuber: Tuber, rng: Generator, *, mean_m: float) -> Tuber:
    """The tuber under a patchy layer of soil of about that mean thickness; sizes and weight stay its own."""
    far = np.linalg.norm(tuber.vertices, axis=1, keepdims=True)
    patches = smooth_relief(rng, tuber.vertices / far, rms=0.8, finest=9.0)
    thickness = mean_m * np.maximum(1 + patches, 0.0)
    soiled = tuber.vertices * (1 + thickness[:, None] / far)
    return replace(tuber, vertices=soiled, bare=tuber.vertices)


def smooth_relief(
    rng: Generator, directions: Vertices, *, rms: float, finest: float = 13.0, fall: float = 0.5
) -> NDArray[np.float64]:
    """(V,) smooth noise over the sphere of the given rms: waves of k = 2..`finest` radians, height ~ k^-`fall`."""
    waves = 28
    k = rng.uniform(2.0, finest, waves)
    vectors = rng.standard_normal((waves, 3))
    vectors *= (k / np.linalg.norm(vectors, axis=1))[:, None]
    heights = k ** (0.5 - fall) / np.sqrt(k)  # a power alone may differ in its last bit from machine to machine
    field = np.cos(directions @ vectors.T + rng.uniform(0, 2 * np.pi, waves)) @ heights
    field -= field.mean()
    return np.asarray(field * (rms / field.std()))


def _draw_form(recipe: Recipe, rng: Generator, directions: Vertices) -> _Form:
    rms, bumps = 0.022 * float(np.exp(0.35 * rng.standard_normal())), recipe.relief
    relief = (
        smooth_relief(rng, directions, rms=min(rms, 0.06))
        if bumps is None
        else smooth_relief(rng, directions, rms=bumps.rms, finest=bumps.finest, fall=bumps.fall)
    )
    lobes = _second_growth(rng, directions, recipe.knobs) if recipe.knobs > 0 else np.zeros(len(directions))
    return _Form(
        relief=relief,
        lobes=lobes,
        bend=float(np.clip(0.06 * rng.standard_normal(), -0.2, 0.2)),
        bend_side=float(np.clip(0.04 * rng.standard_normal(), -0.12, 0.12)),
        taper=float(np.clip(0.10 * rng.standard_normal(), -0.25, 0.25)),
    )


def _second_growth(rng: Generator, directions: Vertices, strength: float) -> NDArray[np.float64]:
    """(V,) radius of the union of knobs, spheres that sit on the unit body, seen from its centre; 0 beside them."""
    reach = np.zeros(len(directions))
    for _ in range(int(rng.integers(1, 5))):
        towards = rng.standard_normal(3)
        towards /= np.linalg.norm(towards)
        radius = rng.uniform(0.30, 0.60)
        stands_out = strength * rng.uniform(0.25, 0.9)
        distance = 1.0 + stands_out - radius
        along = directions @ towards * distance
        inside = along * along - distance * distance + radius * radius
        hit = np.where(inside > 0, along + np.sqrt(np.maximum(inside, 0)), 0.0)
        reach = np.maximum(reach, hit)
    return reach


def _shape(directions: Vertices, form: _Form, fullness: float, half_m: Vertices) -> Vertices:
    """(V, 3) metres: the body of the given fullness with everything of `form`, fitted into the box of the axes."""
    powers = np.abs(directions.T) ** fullness
    radius = (powers[0] + powers[1] + powers[2]) ** (-1 / fullness)
    radius = (radius**16 + form.lobes**16) ** (1 / 16) * (1 + form.relief)
    x, y, z = directions.T * radius
    swell = 1 + form.taper * x
    y = y * swell + form.bend_side * x**2
    z = z * swell + form.bend * x**2
    points = np.array([x, y, z]).T
    low, high = points.min(axis=0), points.max(axis=0)
    return np.ascontiguousarray((points - (low + high) / 2) * (2 * half_m / (high - low)))
