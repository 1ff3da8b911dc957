"""Loops over pixels and points as machine code: numba's compiler as all kernels here use it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from numba import njit
from numba.np import linalg

F = TypeVar("F", bound=Callable[..., Any])


def kernel(**options: Any) -> Callable[[F], F]:
    """Compile a function at its first call, and keep what was compiled beside its file for all later processes.

    Args:
        options: numba's, as `nogil`, `error_model` or `fastmath`.
    """
    compiled: Callable[[F], F] = njit(cache=True, **options)
    return compiled


def _leave_blas() -> None:
    """Let numba load its code for arrays without SciPy's linear algebra, a quarter of a second of each process.

    It looks whether that is there when it loads a process's first kernel. A kernel that multiplies matrices asks for it
    again; ours do not. A numba that does otherwise is left as it is.
    """
    ensure_blas = getattr(linalg, "ensure_blas", None)
    if ensure_blas is None:
        return

    def later() -> None:
        raise ImportError

    linalg.ensure_blas = later
    try:
        from numba.np import arraymath
    finally:
        linalg.ensure_blas = ensure_blas
    arraymath._HAVE_BLAS = True


_leave_blas()


@kernel()
def _nothing() -> None:
    """Of all kernels the one that costs least to load."""


def load_compiler() -> None:
    """Load what numba needs for a process's first kernel, a quarter of a second, before others are forked from it."""
    _nothing()


@contextmanager
def compiled_once(what: str) -> Iterator[None]:
    """Around the first calls of some kernels: of processes that begin together where nothing was ever compiled, one
    compiles, and the others wait for what it keeps. Else none waits.

    Args:
        what: a name for these kernels, part of a file's name beside what is kept.
    """
    import fcntl  # not everywhere where a cloud can be weighed

    _nothing()
    with ExitStack() as stack:
        if _nothing.stats.cache_misses:  # type: ignore[attr-defined]
            with suppress(OSError):  # where nothing can be kept each has to compile
                lock = Path(_nothing.stats.cache_path) / f"compiling-{what}.lock"  # type: ignore[attr-defined]
                fcntl.flock(stack.enter_context(lock.open("wb")), fcntl.LOCK_EX)
        yield
