"""Standard input, output and error of a command: one that the caller has closed (`>&-`) is the null device."""

from __future__ import annotations

import io
import os
import sys
from typing import TextIO

_DESCRIPTORS = range(3)


def keep_standard_streams() -> None:
    """Open on the null device what of the three is closed, for this process and for those it starts. Before any file is
    opened: it would get the free number, and what a library writes to standard error would go into a ledger.

    Python has None in place of such a stream; what is written to it now is lost, as who closed it asked for.
    """
    for number in _DESCRIPTORS:
        try:
            os.fstat(number)
        except OSError:
            _open_null(number)
    sys.stdin = sys.stdin or io.TextIOWrapper(io.FileIO(0, closefd=False))
    sys.stdout = sys.stdout or _writer(1)
    sys.stderr = sys.stderr or _writer(2)


def _open_null(number: int) -> None:
    opened = os.open(os.devnull, os.O_RDWR)
    if opened != number:
        os.dup2(opened, number)
        os.close(opened)
    os.set_inheritable(number, True)


def _writer(number: int) -> TextIO:
    return io.TextIOWrapper(io.FileIO(number, "w", closefd=False), encoding="utf-8", errors="backslashreplace")
