"""One-to-one matching of points within a gate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def one_to_one(cost: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Pairs (row, column) of the cheapest one-to-one matching, rows ascending.

    Args:
        cost: (n, m) float64; a pair is allowed below 1, and leaving a row and a column alone costs 1.
    """
    allowed = cost < 1.0
    if allowed.sum(axis=0).max(initial=0) <= 1 and allowed.sum(axis=1).max(initial=0) <= 1:
        return [(int(i), int(j)) for i, j in np.argwhere(allowed)]  # nothing to choose between
    # Here and not above: it takes longer to load than all the rest of a command that reads a ledger.
    from scipy.optimize import linear_sum_assignment

    capped = np.minimum(cost, 1.0)
    rows, columns = linear_sum_assignment(capped)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if cost[i, j] < 1.0]


def make_ready() -> None:
    """Load what the first choice between pairs needs, half a second and more on a busy machine: a live line must not
    wait for it on its way.
    """
    one_to_one(np.zeros((2, 2)))
