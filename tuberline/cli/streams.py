"""Standard input, output and error of a command: one that the caller has closed (`>&-`) is the null device, and so is
one whose reader has left (`| head`).
"""

from __future__ import annotations

import io
import os
import stat
import sys
from collections.abc import Sequence
from typing import Any, TextIO

_DESCRIPTORS = range(3)
READ_TO_THE_END = (("top",), ("ledger", "dump"), ("ledger", "export"))
"""Commands that do nothing but print, without an end or for long: who has read enough ends them."""


class ReaderLeft(SystemExit):
    """No one reads any more what this command is for."""


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


def outlive_readers(words: Sequence[str]) -> None:
    """What is printed into a pipe whose reader has left is lost, and the command goes on to the exit code that it has
    else: an audit that finds a fault says so by its code, however much of its table is read. Else the code would hang
    on how far it had come, for what is printed before the reader leaves is no error.

    Args:
        words: the command line; one of `READ_TO_THE_END` ends there, with 0.
    """
    prints_only = any(tuple(words[: len(command)]) == command for command in READ_TO_THE_END)
    sys.stdout = _outliving(sys.stdout, 1, ends=prints_only)
    sys.stderr = _outliving(sys.stderr, 2, ends=False)


def _outliving(stream: TextIO, number: int, *, ends: bool) -> TextIO:
    kind = os.fstat(number).st_mode
    if not (stat.S_ISFIFO(kind) or stat.S_ISSOCK(kind)) or not isinstance(stream, io.TextIOWrapper):
        return stream
    stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(_Outliving(number, ends=ends)),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


class _Outliving(io.FileIO):
    """A pipe that becomes the null device when its reader has left."""

    def __init__(self, number: int, *, ends: bool) -> None:
        super().__init__(number, "w", closefd=False)
        self._ends = ends

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self.fileno())
            os.close(null)
        if self._ends:
            raise ReaderLeft(0)
        return memoryview(data).nbytes


def _open_null(number: int) -> None:
    opened = os.open(os.devnull, os.O_RDWR)
    if opened != number:
        os.dup2(opened, number)
        os.close(opened)
    os.set_inheritable(number, True)


def _writer(number: int) -> TextIO:
    return io.TextIOWrapper(io.FileIO(number, "w", closefd=False), encoding="utf-8", errors="backslashreplace")
