"""A smooth surface over a yield map, by ordinary kriging with a fitted variogram (gstools, an extra)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aggregator.yield_map.cells import YieldMap
from conveyor.errors import InputError
from conveyor.extras import install_hint
from conveyor.statistics import NORMAL_90

MOST_CELLS = 2500
"""Kriging solves one equation per cell; larger fields are to be given larger cells."""


def smoothed(cells: YieldMap) -> YieldMap:
    """The same cells, each with the surface's value there and the surface's own 90 % interval.

    Raises:
        InputError: gstools is not installed, or there are too few or too many cells.
    """
    try:
        import gstools
    except ImportError as error:
        raise InputError(f"a smooth map needs gstools, which is not installed; {install_hint('map')}") from error
    known = np.isfinite(cells.t_ha)
    if not 12 <= known.sum() <= MOST_CELLS:
        raise InputError(
            f"a smooth map needs 12 to {MOST_CELLS} cells, this one has {known.sum()}: choose "
            f"{'smaller' if known.sum() < 12 else 'larger'} cells than {cells.cell_m:g} m"
        )
    centres = cells.centres_m()[known]
    values = cells.t_ha[known]
    bins, gamma = gstools.vario_estimate(centres.T, values)
    model = gstools.Exponential(dim=2)
    model.fit_variogram(bins, gamma, nugget=True)
    noise = ((cells.high_t_ha - cells.low_t_ha)[known] / 2 / NORMAL_90) ** 2
    kriging = gstools.krige.Ordinary(model, cond_pos=centres.T, cond_val=values, cond_err=noise, exact=False)
    surface, variance = kriging(centres.T)
    t_ha, low, high = (np.full(cells.t_ha.shape, np.nan) for _ in range(3))
    half = NORMAL_90 * np.sqrt(np.maximum(variance, 0))
    t_ha[known], low[known], high[known] = surface, np.maximum(surface - half, 0), surface + half
    return replace(cells, t_ha=t_ha, low_t_ha=low, high_t_ha=high)
