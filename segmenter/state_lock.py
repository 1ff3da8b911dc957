"""One segmenter at a time keeps a camera's log: two that wrote one would send each other's tubers as their own."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from conveyor.errors import LedgerError, StorageError
from conveyor.files import cause, may_pass


@contextmanager
def only_here(folder: Path | None, name: str) -> Iterator[None]:
    """Within this block no other process keeps the logs of `name` in `folder`; None: there are none to keep.

    Raises:
        StorageError: another process does, or the folder's disk is full, read-only or away. LedgerError: the folder
            cannot be made or written, and another try would not help.
    """
    if folder is None:
        yield
        return
    path = folder / f"{name}.lock"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        taken = isinstance(error, FileExistsError)
        why = f"a file is there: {folder}" if taken else cause(error)
        text = f"folder {folder} for the camera's log (segmenter.state_dir) cannot be used: {why}; name another folder"
        raise (StorageError(text) if may_pass(error) else LedgerError(text)) from error
    try:
        _take(lock, path)
        yield
    finally:
        os.close(lock)


def _take(lock: int, path: Path) -> None:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        why = "another process keeps them" if isinstance(error, BlockingIOError) else error.strerror
        raise StorageError(
            f"the logs {path.with_suffix('')}.* cannot be kept: {why}; stop that one, or give each line its own name "
            "or segmenter.state_dir"
        ) from error
