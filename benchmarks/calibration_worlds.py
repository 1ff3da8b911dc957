"""Lines with an unknown offset, factor and cultivar, at the level of tubers: what the calibration benchmark draws.

Sizes and weights come from the distributions fitted to real tubers (`camera_sim.sim.cultivars`). No pixel is rendered:
what a line reads is the true weight, less a factor, less what the tuber's own outline makes of the offset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from aggregator.calibration.sensitivity import outline_g_per_mm
from camera_sim.sim.cultivars import WEIGHT_RANGE_G, Stock, draw_stock

Floats = NDArray[np.float64]

TUBER_SD = 0.08
"""Of a tuber's weight by itself (8.3 % in the facts)."""
OUTLINE_SD = 0.08
"""Of what a millimetre is worth on a tuber, beside its outline."""
SHARED_SD = 0.025
"""Of what the weigher misjudges in all tubers of a line."""
DENSITY_SD, CULTIVAR_SD = 0.02, 0.02
CAMERA_SCALE = 0.01
OFFSET_MM = (-2.0, 8.0)
MIX_SD = 0.03
"""Of a load's sizes (ln of each axis) against another load of the same line."""
COVERAGE = (0.97, 1.0)
LOAD_TUBERS, BUCKET_TUBERS = 5000, 50
LOAD_SCALE_SD, BUCKET_SCALE_SD = 0.003, 0.002


@dataclass(frozen=True, slots=True)
class World:
    """One line: its cultivar, resting offset in mm, and what true weights are over readings on the right level.

    `between_sd` is what differs from load to load beside sizes.
    """

    stock: Stock
    offset_mm: float
    factor: float
    between_sd: float


@dataclass(frozen=True, slots=True)
class Passed:
    """Tubers that passed: (n,) true grams, grams as weighed, grams per mm by outline, and whether seen."""

    truth_g: Floats
    weighed_g: Floats
    per_mm_g: Floats
    seen: NDArray[np.bool_]
    coverage: float

    @property
    def sd_g(self) -> Floats:
        """(n,) as an interval of the ledger states it."""
        return TUBER_SD * self.weighed_g


def draw_world(rng: Generator, *, between_sd: float) -> World:
    """A line of unknown offset and factor."""
    scale = 3 * np.log1p(rng.uniform(-CAMERA_SCALE, CAMERA_SCALE))
    shared = rng.normal(0.0, np.sqrt(SHARED_SD**2 + DENSITY_SD**2 + CULTIVAR_SD**2))
    return World(draw_stock(rng), float(rng.uniform(*OFFSET_MM)), float(np.exp(shared + scale)), between_sd)


def draw_passed(world: World, n: int, rng: Generator, *, coverage: float = 1.0) -> Passed:
    """`n` tubers of the world, as its line reads them."""
    truth_g, outline_mm2 = _draw_tubers(world.stock, n, rng, shift=float(rng.normal(0.0, MIX_SD)))
    length_mm, width_mm = outline_mm2.T
    per_mm_g = np.array(outline_g_per_mm(1.0, 1.0)) * length_mm * width_mm
    true_per_mm_g = per_mm_g * np.exp(rng.normal(0.0, OUTLINE_SD, n))
    between = rng.normal(0.0, world.between_sd)
    read_g = truth_g / world.factor * np.exp(-between) - true_per_mm_g * world.offset_mm
    weighed_g = np.maximum(read_g * np.exp(rng.normal(0.0, TUBER_SD, n)), 2.0)
    return Passed(truth_g, weighed_g, per_mm_g, rng.random(n) < coverage, coverage)


def draw_load(world: World, rng: Generator) -> Passed:
    """A load, seen almost whole."""
    return draw_passed(world, LOAD_TUBERS, rng, coverage=float(rng.uniform(*COVERAGE)))


def _draw_tubers(stock: Stock, n: int, rng: Generator, *, shift: float) -> tuple[Floats, Floats]:
    """((n,) grams, (n, 2) outline length and width in mm)."""
    full = np.zeros((4, 4))
    full[np.triu_indices(4)] = np.asarray(stock.covariance) * 1e-6
    root = np.linalg.cholesky(full + full.T - np.diag(np.diag(full)))
    logs = np.asarray(stock.mean) + rng.standard_normal((3 * n, 4)) @ root.T
    axes = np.sort(np.exp(logs[:, :3] + shift), axis=1)[:, ::-1]
    grams = np.exp(logs[:, 3]) * np.pi / 6 * axes.prod(axis=1) / 1000
    if stock.weight_gamma is not None:
        wanted = rng.gamma(*stock.weight_gamma, 3 * n) * np.exp(3 * shift)
        axes, grams = axes * (wanted / grams)[:, None] ** (1 / 3), wanted
    fine = np.flatnonzero((grams >= WEIGHT_RANGE_G[0]) & (grams <= WEIGHT_RANGE_G[1]))[:n]
    return grams[fine], axes[fine, :2]
