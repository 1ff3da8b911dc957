"""The folder in which the cameras and segmenters of one supervisor meet: in memory where that can be, theirs alone.

A supervisor that was killed leaves its folder behind, and memory with it: the next one takes it away. That it is dead
is told by the lock that it held, which works across containers that share the memory and not the process ids.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from conveyor.frame_ring import IN_MEMORY

PREFIX = "tuberline-"
LOCK = "lock"
YOUNG_S = 60.0
"""A folder without a lock that is no older may still get one."""


class DirectFolder:
    """Made when it is opened, gone when it is closed; holds sockets and frames."""

    def __init__(self, *, memory: Path = IN_MEMORY) -> None:
        sweep(memory)
        try:
            self.path = Path(tempfile.mkdtemp(prefix=PREFIX, dir=memory))
        except OSError:  # no such file system here, or no right to it: frames pass the sockets
            self.path = Path(tempfile.mkdtemp(prefix=PREFIX))
        self._lock = os.open(self.path / LOCK, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
        fcntl.flock(self._lock, fcntl.LOCK_EX)

    def close(self) -> None:
        """Take it away, with all that is in it."""
        shutil.rmtree(self.path, ignore_errors=True)
        with suppress(OSError):
            os.close(self._lock)


def sweep(memory: Path) -> None:
    """Take away the folders of this user's supervisors that are dead."""
    for folder in memory.glob(f"{PREFIX}*"):
        with suppress(OSError):
            if folder.is_symlink() or folder.stat().st_uid != os.geteuid() or _held(folder):
                continue
            shutil.rmtree(folder, ignore_errors=True)


def _held(folder: Path) -> bool:
    try:
        lock = os.open(folder / LOCK, os.O_WRONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return time.time() - folder.stat().st_mtime < YOUNG_S
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(lock)
    return False
