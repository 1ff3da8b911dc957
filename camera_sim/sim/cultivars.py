"""How real tubers are distributed: the numbers of the 859 tubers of the PointRAFT paper, and draws from them.

Axes L >= W >= D are caliper axes in mm; k = weight / (pi/6 L W D) in g/ml, so density times shape factor. Means and
covariances of (ln L, ln W, ln D, ln k) were fitted to the public ground truth of 3DPotatoTwin (pieterblok/pointraft and
GroteGitJeppo/PointSDF). The 2025 season has mesh axes only, which exceed caliper axes: its two components (small round
tubers; large ones with second growth) are shifted by the difference seen on the Kitahime of 2023. Of 2024 only weights
are public: a gamma distribution on the Kitahime shape of 2023.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

WEIGHT_RANGE_G = (16.0, 624.0)


@dataclass(frozen=True, slots=True)
class Stock:
    """Tubers of one kind in one season.

    Attributes:
        count: tubers of this kind in the paper's set; its share among simulated ones.
        mean, covariance: of (ln L, ln W, ln D, ln k), covariance as its 10 upper entries row by row, x 1e-6.
        density_g_ml: mean and standard deviation.
        knobby: share of tubers with second growth of ordinary strength.
        knobs_by_k: second growth is what makes k small in this kind (correlation of convexity and k: 0.84).
        weight_gamma: shape and scale in grams, where weights are known better than sizes.
    """

    cultivar: str
    season: str
    count: int
    mean: tuple[float, float, float, float]
    covariance: tuple[float, ...]
    density_g_ml: tuple[float, float]
    knobby: float = 0.05
    knobs_by_k: bool = False
    weight_gamma: tuple[float, float] | None = None

    @property
    def typical_axes_mm(self) -> tuple[float, float, float]:
        """Medians of the sorted axes."""
        return math.exp(self.mean[0]), math.exp(self.mean[1]), math.exp(self.mean[2])


@dataclass(frozen=True, slots=True)
class Relief:
    """Bumps of a tuber's skin: their rms as a share of its radius, the finest waves in radians, and how fast they fall
    off with finer ones."""

    rms: float
    finest: float
    fall: float


@dataclass(frozen=True, slots=True)
class Recipe:
    """What one tuber shall be: sorted axes in mm, its volume, density and the strength of its second growth, 0 to 1.

    `relief`: None is that of ordinary tubers.
    """

    stock: Stock
    axes_mm: tuple[float, float, float]
    volume_ml: float
    density_g_ml: float
    knobs: float
    relief: Relief | None = None


_KITAHIME = (22192, 18811, 12845, -741, 17648, 11222, -676, 14237, -1601, 3199)

STOCKS: tuple[Stock, ...] = (
    Stock(
        "Sayaka",
        "2023",
        280,
        (4.3176, 4.1307, 3.9462, 0.1617),
        (46728, 30458, 24524, -594, 26062, 20521, -399, 20885, -1230, 7443),
        (1.074, 0.0214),
    ),
    Stock("Kitahime", "2023", 31, (4.2245, 4.1592, 4.0197, 0.2046), _KITAHIME, (1.0695, 0.0094)),
    Stock(
        "Corolle",
        "2023",
        30,
        (4.4241, 3.8851, 3.7497, 0.1781),
        (37453, 26033, 22375, 4123, 23895, 20855, 882, 22295, -256, 5007),
        (1.0494, 0.0118),
        knobby=0.15,
    ),
    Stock(
        "Haruka",
        "2023",
        30,
        (4.5125, 3.9383, 3.7711, 0.1993),
        (46623, 28704, 23456, 3338, 27086, 20231, -1678, 20744, -3340, 7511),
        (1.071, 0.021),
    ),
    Stock(
        "Kitahime",
        "2024",
        258,
        (4.2245, 4.1592, 4.0197, 0.1600),
        _KITAHIME,
        (1.0690, 0.0110),
        knobby=0.25,
        weight_gamma=(2.43, 70.67),
    ),
    Stock(
        "Kitahime",
        "2025",
        106,
        (3.9155, 3.9134, 3.7574, 0.1621),
        (107283, 101803, 100514, -6618, 100242, 98774, -6106, 99757, -5937, 2467),
        (1.0688, 0.0109),
        knobby=0.08,
    ),
    Stock(
        "Kitahime",
        "2025",
        124,
        (4.5032, 4.3524, 4.0982, -0.0412),
        (82475, 63595, 60695, -4809, 71029, 60719, -10359, 64091, -7534, 32711),
        (1.0688, 0.0109),
        knobs_by_k=True,
    ),
)


ODD_STOCK = Stock("odd", "none", 0, STOCKS[0].mean, STOCKS[0].covariance, (1.07, 0.02))
"""Shapes of no cultivar, drawn by `tubers.draw_odd_tuber`; only its names and its density are used."""


@lru_cache(maxsize=32)
def _root(covariance: tuple[float, ...]) -> NDArray[np.float64]:
    """(4, 4) lower Cholesky factor of a stock's covariance."""
    full = np.zeros((4, 4))
    full[np.triu_indices(4)] = np.asarray(covariance) * 1e-6
    full = full + full.T - np.diag(np.diag(full))
    return np.asarray(np.linalg.cholesky(full), np.float64)


def draw_stock(rng: Generator) -> Stock:
    """One of all stocks, as often as in the paper's set."""
    counts = np.array([stock.count for stock in STOCKS], float)
    return STOCKS[int(rng.choice(len(STOCKS), p=counts / counts.sum()))]


def draw_recipe(rng: Generator, *, stock: Stock | None = None) -> Recipe:
    """One tuber of `stock`, or from the mixture of all stocks, 16 to 624 g."""
    stock = stock or draw_stock(rng)
    while True:
        log_lwd_k = np.asarray(stock.mean) + _root(stock.covariance) @ rng.standard_normal(4)
        axes = np.sort(np.exp(log_lwd_k[:3]))[::-1]
        density = stock.density_g_ml[0] + stock.density_g_ml[1] * float(np.clip(rng.standard_normal(), -2.5, 2.5))
        weight_g = float(np.exp(log_lwd_k[3]) * np.pi / 6 * axes.prod() / 1000)
        if stock.weight_gamma is not None:
            wanted_g = float(rng.gamma(stock.weight_gamma[0], stock.weight_gamma[1]))
            axes = axes * (wanted_g / weight_g) ** (1 / 3)
            weight_g = wanted_g
        knobs = float(rng.uniform(0.2, 0.6)) if rng.random() < stock.knobby else 0.0
        if stock.knobs_by_k:
            knobs = float(np.clip((0.13 - log_lwd_k[3]) / 0.35, 0.0, 1.0))
        if WEIGHT_RANGE_G[0] <= weight_g <= WEIGHT_RANGE_G[1] and axes[0] < 160 and axes[2] > 18:
            return Recipe(stock, (float(axes[0]), float(axes[1]), float(axes[2])), weight_g / density, density, knobs)
