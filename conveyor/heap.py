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
from typing import Any

GIVE_BACK_EVERY_S = 30.0


def give_back() -> bool:
    """Return all free pages of the heap to the system; False where the C library has no such call (musl, macOS)."""
    trim = _trim()
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
def _trim() -> Callable[[int], Any] | None:
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError):
        return None
    trim.argtypes, trim.restype = [ctypes.c_size_t], ctypes.c_int
    return trim
