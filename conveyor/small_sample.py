"""Intervals from few weights that hold with a stated probability.

The share of all tubers that lies within the k-th smallest of n independent absolute errors is Beta(k, n + 1 - k)
distributed, whatever the errors' own distribution is. A level chosen for the mean alone covers less than it says in
half of all calibrations; the rank chosen here covers in `confidence` of them (SSBC, arXiv 2509.15349).
"""

from __future__ import annotations

import math
from collections.abc import Sequence


def holding_rank(n: int, *, coverage: float = 0.9, confidence: float = 0.9) -> int | None:
    """The smallest k whose interval covers `coverage` in at least `confidence` of all samples of n; None: too few.

    P(Beta(k, n + 1 - k) >= c) is P(Binomial(n, c) <= k - 1).
    """
    below = 0.0
    for k in range(1, n + 1):
        below += math.exp(_log_binomial(n, k - 1) + (k - 1) * math.log(coverage) + (n - k + 1) * math.log1p(-coverage))
        if below >= confidence:
            return k
    return None


def holding_half_width(errors: Sequence[float], *, coverage: float = 0.9, confidence: float = 0.9) -> float | None:
    """Half-width of the interval about 0 that covers `coverage` of what is to come, in `confidence` of all cases.

    None: there are too few errors to say so (22 at 90 % and 90 %).
    """
    rank = holding_rank(len(errors), coverage=coverage, confidence=confidence)
    return None if rank is None else sorted(abs(error) for error in errors)[rank - 1]


def _log_binomial(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
