"""How far a body seen from above departs from the ellipsoid that fits it best: what a clod is, and a tuber hardly.

A quadric seen along z is h = P(x, y) + sqrt(P^2 + Q(x, y)), P linear and Q quadratic: its mid-surface and what rises
over it, whichever way it lies. So h^2 = 2 h P + Q is linear in the nine coefficients, and a solve of nine equations
fits it (algebraic distance; Taubin 1991, "Estimation of planar curves, surfaces, and nonplanar space curves").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel

SURE, PARTLY = 0.8, 0.3
"""Share of a cell that must be the body's to be fitted, and to be compared."""
FEWEST = 30
HEIGHT_UNIT, CELL_UNIT = 20.0, 10.0
"""Millimetres and cells that make 1, so that all nine equations weigh alike."""
RIDGE_MID, RIDGE = 1e-4, 1e-7
"""Of the mid-surface, which a flat body does not fix, and of the rest."""


@kernel()
def departures(mean_mm: NDArray[np.float32], share: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, s, s) float32 millimetres above the quadric through each body, times `share`; 0 outside and where too little
    of a body is seen.

    Args:
        mean_mm: (n, s, s) heights from above, millimetres.
        share: (n, s, s) how much of each cell is the body, 0 to 1.
    """
    out = np.zeros(mean_mm.shape, np.float32)
    for n in range(len(mean_mm)):
        _departure(mean_mm[n], share[n], out[n])
    return out


@kernel()
def _departure(mean_mm: NDArray[np.float32], share: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    size = mean_mm.shape[0]
    half = size / 2 - 0.5
    matrix, right, terms, count = np.zeros((9, 9)), np.zeros(9), np.zeros(9), 0
    for i in range(size):
        for j in range(size):
            if share[i, j] <= SURE:
                continue
            h, x, y = mean_mm[i, j] / HEIGHT_UNIT, (i - half) / CELL_UNIT, (j - half) / CELL_UNIT
            terms[0], terms[1], terms[2], terms[3], terms[4] = h, x * h, y * h, 1.0, x
            terms[5], terms[6], terms[7], terms[8] = y, x * x, x * y, y * y
            for p in range(9):
                right[p] += terms[p] * h * h
                for q in range(9):
                    matrix[p, q] += terms[p] * terms[q]
            count += 1
    if count < FEWEST:
        return
    for p in range(9):
        matrix[p, p] += count * (RIDGE_MID if p < 3 else RIDGE)
    a = np.linalg.solve(matrix, right)
    for i in range(size):
        for j in range(size):
            if share[i, j] > PARTLY:
                x, y = (i - half) / CELL_UNIT, (j - half) / CELL_UNIT
                middle = (a[0] + a[1] * x + a[2] * y) / 2
                under = middle * middle + a[3] + a[4] * x + a[5] * y + a[6] * x * x + a[7] * x * y + a[8] * y * y
                surface_mm = (middle + np.sqrt(max(under, 0.0))) * HEIGHT_UNIT
                out[i, j] = (mean_mm[i, j] - surface_mm) * share[i, j]
