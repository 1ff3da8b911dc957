"""How many threads products of matrices take.

Sums are rounded otherwise by two threads than by one, and where other work goes on two are slower. So a weight's
products take one thread, unless the process was told otherwise, whatever NumPy takes beside.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from threadpoolctl import OpenBLASController, ThreadpoolController, threadpool_limits

_lock = threading.Lock()
_wanted, _inside = 1, 0
_changed: list[tuple[Any, int]] = []
"""Libraries that took another number of threads before the first came inside, and which."""


def use_threads(count: int) -> None:
    """So many in this process from now on: of the libraries that are loaded, NumPy's, and of those to come, torch's."""
    global _wanted
    _wanted = count
    threadpool_limits(count)
    os.environ["OMP_NUM_THREADS"] = str(count)


@contextmanager
def own_threads() -> Iterator[None]:
    """NumPy's products take one thread, or as many as `use_threads` said, until the last who is inside has left."""
    global _inside
    with _lock:
        if not _inside:
            had = [(library, library.get_num_threads()) for library in _libraries()]
            _changed[:] = [(library, count) for library, count in had if count != _wanted]
            for library, _ in _changed:
                _set(library, _wanted)
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if not _inside:
                for library, count in _changed:
                    _set(library, count)


def _set(library: Any, count: int) -> None:
    """Whichever thread calls: threadpoolctl lets the thread that set an OpenBLAS first set it again, and no other."""
    _free(library)
    library.set_num_threads(count)
    _free(library)


def _free(library: Any) -> None:
    if isinstance(library, OpenBLASController):
        library.clear_controlling_thread(force=True)


@cache
def _libraries() -> tuple[Any, ...]:
    """That multiply matrices and are loaded when the first weight is asked for: NumPy's is among them."""
    return tuple(library for library in ThreadpoolController().lib_controllers if library.user_api == "blas")
