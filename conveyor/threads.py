"""How many threads products of matrices take."""

from __future__ import annotations

import os

from threadpoolctl import threadpool_limits


def use_threads(count: int) -> None:
    """So many in this process from now on: of the libraries that are loaded, NumPy's, and of those to come, torch's."""
    threadpool_limits(count)
    os.environ["OMP_NUM_THREADS"] = str(count)
