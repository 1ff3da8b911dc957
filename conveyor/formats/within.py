"""Recordings come from elsewhere: nothing in one may lead out of it, neither a name nor a link."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from conveyor.errors import InputError

MOST_NAME = 200


def plain_name(name: str, *, where: object) -> str:
    """A camera's name as a recording gives it: it becomes a folder's name and part of what is shown.

    Raises:
        InputError: it climbs, is absolute, or holds a separator or a control character.
    """
    if name in ("", ".", "..") or len(name) > MOST_NAME or any(c in "/\\\0" or not c.isprintable() for c in name):
        raise InputError(
            f"{where} names a camera {name[:MOST_NAME]!a}, which is no plain name: allowed are 1 to {MOST_NAME} "
            "printable characters without '/' and '\\', and not '..'; correct the recording, or do not trust it"
        )
    return name


def check_within(folder: Path) -> None:
    """Nothing in `folder` is a link that leaves it, a device or a pipe. `folder` itself may be reached by a link.

    Raises:
        InputError: something is; names it.
    """
    root = folder.resolve()
    for path in _entries(folder):
        mode = path.lstat().st_mode
        if stat.S_ISLNK(mode):
            _check_link(path, root, folder)
        elif not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise InputError(f"{path} is no file but a device, a pipe or a socket; a recording holds none: remove it")


def _check_link(path: Path, root: Path, folder: Path) -> None:
    try:
        target = path.resolve(strict=False)
        with suppress(FileNotFoundError):
            path.stat()  # of a link to itself Python 3.13 resolves nothing and says nothing
    except (OSError, RuntimeError) as error:
        raise InputError(f"{path} is a link that leads nowhere: {error}; remove it") from error
    if not target.is_relative_to(root):
        raise InputError(
            f"{path} is a link out of the recording, to {target}; what a recording holds lies within {folder}: "
            "put a copy there instead, or remove it"
        )
    if target.exists() and not (target.is_file() or target.is_dir()):
        raise InputError(f"{path} is a link to a device, a pipe or a socket; a recording holds none: remove it")


def _entries(folder: Path) -> Iterator[Path]:
    """All that is not plainly a file, and folders' contents; links are not followed."""
    waiting = [folder]
    while waiting:
        try:
            with os.scandir(waiting.pop()) as entries:
                for entry in entries:
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append(Path(entry.path))
                    elif not entry.is_file(follow_symlinks=False):
                        yield Path(entry.path)
        except OSError as error:
            raise InputError(f"{error.filename or folder} cannot be read: {error.strerror or error}") from error
