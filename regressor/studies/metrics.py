"""Figures of merit of predicted weights, per view and per fused tuber."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def scores(
    predicted_g: NDArray[np.float64], weight_g: NDArray[np.float64], tuber: NDArray[np.str_]
) -> dict[str, float]:
    """MAE, RMSE, bias (grams), R2 per view, and of the mean of each tuber's views; bias of the total in percent.

    Args:
        predicted_g, weight_g: (n,) per view. tuber: (n,) whose view it is.
    """
    per_view = _errors(predicted_g, weight_g)
    _, owner = np.unique(tuber, return_inverse=True)
    count = np.bincount(owner)
    fused = np.bincount(owner, weights=predicted_g) / count
    truth = np.bincount(owner, weights=weight_g) / count
    per_tuber = _errors(fused, truth)
    return {
        "views": float(len(weight_g)),
        "tubers": float(len(truth)),
        **per_view,
        **{f"tuber_{name}": value for name, value in per_tuber.items()},
        "total_bias_percent": round(100 * float(fused.sum() / truth.sum() - 1), 4),
    }


def _errors(predicted: NDArray[np.float64], truth: NDArray[np.float64]) -> dict[str, float]:
    error = predicted - truth
    spread = float(((truth - truth.mean()) ** 2).sum())
    return {
        "mae_g": round(float(np.abs(error).mean()), 4),
        "rmse_g": round(float(np.sqrt((error**2).mean())), 4),
        "bias_g": round(float(error.mean()), 4),
        "r2": round(1 - float((error**2).sum()) / spread, 5) if spread > 0 else 0.0,
    }
