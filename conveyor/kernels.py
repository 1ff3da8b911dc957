"""Loops over pixels and points as machine code: numba's compiler as all kernels here use it."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeVar

from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.np import linalg

F = TypeVar("F", bound=Callable[..., Any])


def kernel(**options: Any) -> Callable[[F], F]:
    """Compile a function at its first call, and keep what was compiled beside its file for all later processes.

    Args:
        options: numba's, as `nogil`, `error_model` or `fastmath`.
    """

    def compiled(function: F) -> F:
        dispatcher: Any = njit(**options)(function)
        with suppress(RuntimeError):  # no folder can be written: it is compiled in each process
            dispatcher._cache = _Kept(function)
        found: F = dispatcher
        return found

    return compiled


class _Files(IndexDataCacheFile):
    """numba's files of one function, whole at every moment: the power may go at any of them."""

    def save(self, key: Any, data: Any) -> None:
        """The index names what is on the disk and nothing else.

        numba's own names it before: cut off then, a changed function was taken for compiled where an older one's code
        lay under that name.
        """
        named = self._load_index()
        if key not in named:
            self._save_index(named)  # for an older file of the function, this is an empty one
        name = named.get(key) or self._data_name(len(named) + 1)
        self._save_data(name, data)
        self._save_index({**named, key: name})

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[IO[bytes]]:
        with super()._open_for_write(filepath) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())


class _Kept(FunctionCache):
    """What is kept of one function. Where it cannot be read or written the function is compiled, and nothing ends."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = _Files(self.cache_path, self._impl.filename_base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # pickle has no one word for damage
            self._tell("read", error)
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except Exception as error:  # a full disk, and what stood there is damaged too
            self._tell("kept", error)

    def _tell(self, what: str, error: Exception) -> None:
        logging.getLogger("kernels").warning(
            "%s: what was compiled of it in %s cannot be %s, so it is compiled again: %s",
            self._impl.filename_base, self.cache_path, what, error,
        )  # fmt: skip


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
    compiles, and the others wait for what it keeps. Else none waits. Each says so, for it is not there meanwhile.

    Args:
        what: a name for these kernels, part of a file's name beside what is kept.
    """
    import fcntl  # not everywhere where a cloud can be weighed

    _nothing()
    with ExitStack() as stack:
        folder = _nothing.stats.cache_path  # type: ignore[attr-defined]
        if _nothing.stats.cache_misses:  # type: ignore[attr-defined]
            kept = (
                "later starts find it" if folder is not None else "at each start, for no folder can be written for it"
            )
            logging.getLogger("kernels").info("compiling what %s need, a minute or two: %s", what, kept)
        if folder is not None and _nothing.stats.cache_misses:  # type: ignore[attr-defined]
            with suppress(OSError):  # where nothing can be kept each has to compile
                lock = Path(folder) / f"compiling-{what}.lock"
                fcntl.flock(stack.enter_context(lock.open("wb")), fcntl.LOCK_EX)
        yield
