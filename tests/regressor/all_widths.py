"""The widths of an outline along every direction, as `longest_widths` takes each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from regressor.weigh.widths import DIRECTIONS, TRIMMED, _ends, _width


def all_widths(xy: NDArray[np.float64]) -> list[float]:
    """(36,) of (n, 2) points along `DIRECTIONS`."""
    x, y = np.ascontiguousarray(xy.T)
    highest, lowest = _ends(x, y, DIRECTIONS)
    return [_width(x, y, DIRECTIONS[:, d], highest[d], lowest[d], TRIMMED) for d in range(DIRECTIONS.shape[1])]
