"""Gives freed memory back to the system: what the C library keeps of it otherwise only grows.

A process that frees large buffers and keeps small ones between them, as a regressor does (its products of a few MB, and
the cached answers of its publisher), leaves holes that glibc before 2.38 does not use again for aligned buffers: a
regressor's heap grew from 136 to 172 MiB in 10 minutes, 48 MiB of it free (docs/operate.md). Mapping large buffers
one by one instead (MALLOC_MMAP_THRESHOLD_) keeps the heap flat as well, and doubles the time of a weighing.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, cast

GIVE_BACK_EVERY_S = 30.0
KEPT_BYTES = 32 << 20
"""A buffer up to this size comes from the heap, and so much of it stays free at its end: ten images of a frame."""
_MMAP_THRESHOLD, _TRIM_THRESHOLD = -3, -1
"""Of mallopt(3), as glibc's malloc.h numbers them."""


def keep_buffers() -> bool:
    """Let the C library use the buffers of the last frame again for the next one; False where it has no such call.

    By itself it gives them back after each frame and asks for them again: a thousand pages, each of which the system
    clears, 2 ms of a frame of 848x480. `give_back` still returns what is free, twice a minute.
    """
    option = _library_call("mallopt", ctypes.c_int, ctypes.c_int)
    return option is not None and all(option(name, KEPT_BYTES) for name in (_MMAP_THRESHOLD, _TRIM_THRESHOLD))


def give_back() -> bool:
    """Return all free pages of the heap to the system; False where the C library has no such call (musl, macOS)."""
    trim = _library_call("malloc_trim", ctypes.c_size_t)
    if trim is None:
        return False
    trim(0)
    return True


def resident_mib() -> float | None:
    """Memory of this process that is in RAM, MiB; None where the kernel does not say (no /proc)."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, IndexError, ValueError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


@cache
def _library_call(name: str, *arguments: Any) -> Callable[..., Any] | None:
    try:
        call = getattr(ctypes.CDLL(None), name)
    except (OSError, AttributeError):
        return None
    call.argtypes, call.restype = list(arguments), ctypes.c_int
    return cast("Callable[..., Any]", call)
