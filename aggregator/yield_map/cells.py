"""The map itself: square cells with t/ha, counts and 90 % intervals; several machines brought to one scale."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from aggregator.yield_map.no_map import NoMapError, WhyNoMap
from aggregator.yield_map.points import Points
from conveyor.errors import InputError
from conveyor.statistics import NORMAL_90

ALIKE_S = 3.0
"""Webs mix the crop of neighbouring seconds: so many of them say about as much as one."""
MOST_CELLS = 4_000_000
"""20 by 20 km at 10 m: machines that lie farther apart are in several fields."""
LEAST_SHARE = 0.25
"""A cell less than this lifted says little about itself: it is shown as not known."""


@dataclass(frozen=True, slots=True, eq=False)
class YieldMap:
    """Cells of `cell_m` metres, row 0 in the south, column 0 in the west; (R, C) arrays, NaN where nothing is known.

    Attributes:
        origin_m: (2,) south-west corner, metres of the field.
        t_ha: tonnes per hectare of lifted ground.
        low_t_ha, high_t_ha: 90 % interval of each cell by itself: the errors of its tubers' weights, and the scatter
            of the seconds that it is made of. What all cells share (scale, belt not seen) is `shared_percent`, the
            half-width of the whole map's interval.
        kg, area_m2, count: what the cell gave, from how much ground, in how many tubers.
    """

    origin_m: NDArray[np.float64]
    cell_m: float
    t_ha: NDArray[np.float64]
    low_t_ha: NDArray[np.float64]
    high_t_ha: NDArray[np.float64]
    kg: NDArray[np.float64]
    area_m2: NDArray[np.float64]
    count: NDArray[np.float64]
    shared_percent: float = 0.0

    @property
    def mean_t_ha(self) -> float:
        """Of all ground in known cells."""
        known = np.isfinite(self.t_ha)
        return float(10 * self.kg[known].sum() / self.area_m2[known].sum()) if known.any() else float("nan")

    def centres_m(self) -> NDArray[np.float64]:
        """(R, C, 2) middles of the cells, metres of the field."""
        row, column = np.indices(self.t_ha.shape)
        centres: NDArray[np.float64] = self.origin_m + (np.stack([column, row], axis=-1) + 0.5) * self.cell_m
        return centres


def cells_of(machines: Sequence[Points], *, cell_m: float, shared_percent: float = 0.0) -> YieldMap:
    """The map of one field from the used points of one or more machines, already on one scale.

    A second's kilograms lie evenly on the ground that it lifted first.

    Raises:
        InputError: no usable point, a cell size that is none, or more cells than a field has.
    """
    check_cell(cell_m)
    parts = [_squares(points) for points in machines]
    centres = np.concatenate([part[0] for part in parts])
    if not len(centres):
        why_not = sum((Counter(points.reasons()) for points in machines), Counter[str]()).most_common()
        told = ", ".join(f"{n} {why}" for why, n in why_not)
        raise NoMapError(
            f"none of the {sum(len(p.time_s) for p in machines)} seconds of the track can be used ({told}): there is "
            "no map",
            why=WhyNoMap.NO_GROUND,
        )
    values = np.concatenate([part[1] for part in parts])
    origin = np.floor(centres.min(axis=0) / cell_m) * cell_m
    index = np.floor((centres - origin) / cell_m).astype(np.int64)
    columns, rows = (int(n) + 1 for n in index.max(axis=0))
    if columns * rows > MOST_CELLS:
        raise InputError(
            f"what was lifted spans {columns * cell_m / 1000:.1f} by {rows * cell_m / 1000:.1f} km, {columns * rows} "
            f"cells of {cell_m:g} m; a map has up to {MOST_CELLS}: map each field by itself, or give a larger --cell-m"
        )
    flat = index[:, 1] * columns + index[:, 0]
    kg, var, count, area, squared, area_squared = (
        np.bincount(flat, weights=values[:, i], minlength=rows * columns).astype(np.float64).reshape(rows, columns)
        for i in range(6)
    )
    known = area >= LEAST_SHARE * cell_m**2
    with np.errstate(invalid="ignore", divide="ignore"):
        t_ha = np.where(known, 10 * kg / area, np.nan)
        # Weighted by area, the mean square of the seconds' yields about the cell's, over the independent ones.
        between = np.maximum(squared / area - (kg / area) ** 2, 0) * area_squared / area**2 * ALIKE_S
        half = np.where(known, NORMAL_90 * 10 * np.sqrt(var / area**2 + between), np.nan)
    return YieldMap(origin, cell_m, t_ha, np.maximum(t_ha - half, 0), t_ha + half, kg, area, count, shared_percent)


def check_cell(cell_m: float) -> None:
    """Refuse a size that no cell has.

    Raises:
        InputError: it is not between 1 and 1000 m.
    """
    if not 1 <= cell_m <= 1000:
        raise InputError(f"cells are {cell_m:g} m; allowed are 1 to 1000 m")


def _squares(points: Points) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Middles of the fine squares of used points, (M, 2), and (M, 6) of each square: kg, variance, count, area,
    kg^2 / area, and area times that of its second in the cell (what independent seconds are counted by)."""
    ground = points.ground
    used = points.used[ground.second]
    second = ground.second[used]
    each = np.bincount(ground.second, minlength=len(points.time_s)).astype(float)[second]
    kg, area = points.kg[second] / each, points.area_m2[second] / each
    values = [kg, points.var_kg2[second] / each, points.count[second] / each, area]
    values += [kg**2 / np.maximum(area, 1e-9), area * points.area_m2[second]]
    return ground.centres_m[used], np.stack(values, axis=1)


def factors_to_one_scale(machines: Sequence[Points], *, width_m: float) -> list[float]:
    """By what each machine's kilograms are multiplied so that neighbouring ground yields alike; 1.0 in the mean.

    For each pair of machines the yields of ground within two working widths of each other are compared as one ratio
    of sums, by its logarithm; the factors that meet all ratios best are found by weighted least squares. Machines with
    no ground beside another one's keep 1.0. The mean over all lifted ground does not change.
    """
    count = len(machines)
    rows, ratios, weights = [], [], []
    for a in range(count):
        for b in range(a + 1, count):
            found = _ratio(machines[a], machines[b], reach_m=2 * width_m)
            if found is None:
                continue
            row = np.zeros(count)
            row[a], row[b] = 1, -1
            rows.append(row)
            ratios.append(-found[0])
            weights.append(np.sqrt(found[1]))
    if not rows:
        return [1.0] * count
    matrix, scale = np.array(rows), np.array(weights)
    logs = np.linalg.lstsq(matrix * scale[:, None], np.array(ratios) * scale, rcond=None)[0]
    kg = np.array([points.kg[points.used].sum() for points in machines])
    logs -= np.log((kg * np.exp(logs)).sum() / kg.sum())
    return [float(factor) for factor in np.exp(logs)]


def _ratio(a: Points, b: Points, *, reach_m: float) -> tuple[float, int] | None:
    """Logarithm of the yield of `a` over that of `b` on neighbouring ground, and from how many points of each."""
    use_a, use_b = np.flatnonzero(a.used), np.flatnonzero(b.used)
    if not len(use_a) or not len(use_b):
        return None
    near = cKDTree(a.xy_m[use_a]).sparse_distance_matrix(cKDTree(b.xy_m[use_b]), reach_m, output_type="coo_matrix")
    mine, theirs = np.unique(near.row), np.unique(near.col)
    if len(mine) < 20 or len(theirs) < 20:
        return None
    # Each point counts with the number of its neighbours, so that both sides speak of the same ground.
    mine_n, theirs_n = np.bincount(near.row, minlength=len(use_a)), np.bincount(near.col, minlength=len(use_b))
    sums = [
        (n * points.kg[use]).sum() / (n * points.area_m2[use]).sum()
        for n, points, use in ((mine_n, a, use_a), (theirs_n, b, use_b))
    ]
    return (float(np.log(sums[0] / sums[1])), min(len(mine), len(theirs))) if min(sums) > 0 else None
