"""What PointRAFT has to beat: the paper's linear rule, a multiplicative one, and the visible volume.

All are fitted and judged by 5-fold cross-validation over tubers, on the set that is evaluated: that favours them, as
they see the very distribution they are judged on.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

FOLDS = 5
Fit = Callable[[NDArray[np.float64], NDArray[np.float64]], Callable[[NDArray[np.float64]], NDArray[np.float64]]]


def oriented_box_m(points: NDArray[np.floating]) -> tuple[float, float, float]:
    """Sides of the box along the principal axes of the cloud's convex hull, longest first, metres.

    As Open3D's `get_oriented_bounding_box`, which the reference's baseline takes length and width from.
    """
    try:
        corners = points[ConvexHull(points).vertices].astype(np.float64)
    except QhullError:
        corners = points.astype(np.float64)
    axes = np.linalg.eigh(np.cov((corners - corners.mean(0)).T))[1]
    sides = np.sort(np.ptp(corners @ axes, axis=0))[::-1]
    return float(sides[0]), float(sides[1]), float(sides[2])


def fit_linear(features: NDArray[np.float64], weight_g: NDArray[np.float64]) -> Callable[..., NDArray[np.float64]]:
    """Least squares with an intercept: the paper's form."""
    design = np.column_stack([np.ones(len(features)), features])
    coefficients = np.linalg.lstsq(design, weight_g, rcond=None)[0]
    return lambda new: np.column_stack([np.ones(len(new)), new]) @ coefficients


def fit_product(features: NDArray[np.float64], weight_g: NDArray[np.float64]) -> Callable[..., NDArray[np.float64]]:
    """weight = k times the product of the features, with k so that the totals agree."""
    factor = weight_g.sum() / features.prod(1).sum()
    return lambda new: factor * new.prod(1)


def cross_validated(
    fit: Fit, features: NDArray[np.float64], weight_g: NDArray[np.float64], tuber: NDArray[np.str_], *, seed: int = 0
) -> NDArray[np.float64]:
    """(n,) predictions, each by a rule fitted without the view's tuber."""
    _, owner = np.unique(tuber, return_inverse=True)
    folds = np.random.default_rng(seed).permutation(int(owner.max()) + 1)[owner] % FOLDS
    predicted = np.empty(len(weight_g))
    for fold in range(FOLDS):
        held_out = folds == fold
        predicted[held_out] = fit(features[~held_out], weight_g[~held_out])(features[held_out])
    return predicted
