"""Files that are written whole or not at all, and what is said where they cannot be.

What is made is made in a folder beside its place and moved there when it is complete, so that a full disk, a signal or
a fault leaves nothing half-written that looks like a result.
"""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from conveyor.errors import InputError, OutputError

_FIXES = {
    errno.ENOSPC: "free space on that disk, or choose another place",
    errno.EDQUOT: "the quota is used up: free space, or choose another place",
    errno.EFBIG: "files there must not become so large: raise the limit, or choose another place",
    errno.EROFS: "that file system is read-only: choose another place, or mount it for writing",
    errno.EACCES: "this user has no right to it: choose another place, or fix the rights",
    errno.EPERM: "this user has no right to it: choose another place, or fix the rights",
    errno.ENOENT: "check the name and that its folder exists",
    errno.EEXIST: "a file lies where a folder is needed: choose another name",
    errno.ENOTDIR: "a part of that path is a file: choose another name",
    errno.EISDIR: "that is a folder: name a file",
    errno.EADDRINUSE: "another program listens there: stop it, or choose another port",
    errno.EADDRNOTAVAIL: "this machine has no such address: choose one of its own",
    errno.EMFILE: "too many files are open: raise the limit (ulimit -n)",
    errno.EIO: "the disk reports a fault: check it before you go on",
}

_PASSING = frozenset(
    {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.ESTALE, errno.ENODEV, errno.ENXIO, errno.ETIMEDOUT}
)
"""Faults of a disk, which may be gone at the next try. A name, a right or a limit of this user stays as it is."""

LEAST_FREE_BYTES = 256 * 1024
"""With less a database cannot even be opened, though a few bytes still fit."""


def told(error: OSError, where: Path | str | None = None) -> str:
    """A fault of the operating system in one sentence: path, cause, how to fix it."""
    place = error.filename if error.filename is not None else where
    return f"{place if place is not None else 'a file or device'}: {cause(error)}"


@contextmanager
def whole_output(target: Path) -> Iterator[Path]:
    """A path to write a file or a folder to, which becomes `target` when the block ends well.

    The path has the name of `target` and lies in a folder of its own beside it. All that is written into that folder
    (a truth beside a recording, a sidecar beside a network) is moved with it. Where `target` is a folder that is there
    already, what was made is put into it; where nothing can be moved into that from beside it, it is made in it. Where
    the block raises, all of it is removed.

    Raises:
        InputError: the place cannot be written, or is a device or a pipe, or a file that the block reads cannot be; the
            text says which, why, and how to fix it. OutputError: of these a disk that is full, read-only, away or
            reports errors.
    """
    _refuse_device(str(target), target)
    scratch: Path | None = None
    place = target.resolve() if target.is_dir() else target  # '.' and '..' have no name
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{place.name}.partial-", dir=_beside(place)))
        yield scratch / place.name
        for made in sorted(scratch.iterdir()):
            _move(made, place.parent / made.name)
    except OSError as error:
        if scratch is not None and error.filename is not None and str(scratch) not in str(error.filename):
            raise fault_of(error, told(error)) from error  # of what the block reads
        raise fault_of(error, f"{target} cannot be written: {cause(error)}") from error
    except InputError as error:
        if scratch is not None:
            named = str(error).replace(str(scratch / place.name), str(target))
            error.args = (named.replace(str(scratch), str(target.parent)), *error.args[1:])
        raise
    finally:
        if scratch is not None:
            shutil.rmtree(scratch, ignore_errors=True)


@contextmanager
def replacing(path: Path, *, mode: int = 0o666) -> Iterator[BinaryIO]:
    """A file to write, which takes the place of `path` durably where the block ends: who reads sees the old file or the
    new one, also after a power cut. Where anything is raised what was written is gone: a part of it on a full disk
    would keep it full.

    Args:
        mode: of the file from its first byte on, less what the umask takes; 0o600 for a private key.

    Raises:
        OSError: the disk is full, or the folder cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        partial.unlink(missing_ok=True)  # of one that was killed: its mode would stay
        with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode), "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except BaseException:
        with suppress(OSError):  # on a read-only disk this is refused too, whether there is one or not
            partial.unlink(missing_ok=True)
        raise


def free_name(path: Path, taken: Callable[[Path], bool] = Path.exists) -> Path:
    """`path`, or where that is taken the first free one of `<name>-2.<ending>`, `<name>-3.<ending>`, ..."""
    free, n = path, 1
    while taken(free):
        n += 1
        free = path.with_name(f"{path.stem}-{n}{path.suffix}")
    return free


def remove_partials(folder: Path, names: str) -> int:
    """Remove what `whole_output` left of targets in `folder` whose process was killed; how many there were.

    `names`: of the targets, as `fnmatch` has them. Only where no other process writes to those targets.
    """
    left = [path for path in folder.glob(f".{names}.partial-*") if path.is_dir()]
    for path in left:
        shutil.rmtree(path, ignore_errors=True)
    return len(left)


def cause(error: OSError) -> str:
    """Why the operating system refused, and how to fix it."""
    fix = _FIXES.get(error.errno or 0, "")
    return (error.strerror or str(error) or type(error).__name__) + (f"; {fix}" if fix else "")


def may_pass(error: OSError) -> bool:
    """A fault of a disk, which another try may not meet."""
    return error.errno in _PASSING


def fault_of(error: OSError, text: str) -> InputError:
    """The error to raise for a file that cannot be read or written."""
    return OutputError(text) if may_pass(error) else InputError(text)


def check_place(target: Path, *, option: str) -> None:
    """Refuse before minutes of work what could not be written after them; the folder of `target` is made.

    Raises:
        InputError: a folder, a device or a pipe is there, or its own folder cannot be made; named by `option`.
            OutputError: its disk is full or read-only.
    """
    if target.is_dir():
        raise InputError(f"{option} {target} is a folder: name a file")
    _refuse_device(f"{option} {target}", target)
    folder = target.absolute().parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise fault_of(error, f"{option} {target}: its folder cannot be made: {cause(error)}") from error
    if trouble := unwritable(folder):
        raise OutputError(f"{option} {target} cannot be written: {trouble}")


def check_folder(target: Path, *, option: str) -> None:
    """Refuse before minutes of work a folder into which nothing could be written after them; it is made.

    Raises:
        InputError, OutputError: as `check_room`.
    """
    check_room(target, option=option)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise fault_of(error, f"{option} {target} cannot be made: {cause(error)}") from error


def check_room(target: Path, *, option: str) -> None:
    """The same of a folder that is made only where there is something for it.

    Raises:
        InputError: it cannot be made, or this user may not write into it; named by `option`. OutputError: its disk is
            full or read-only.
    """
    place = target.absolute()
    try:
        while not place.exists():
            place = place.parent
    except OSError as error:  # a folder on the way may not be looked into
        raise fault_of(error, f"{option} {target} cannot be made: {cause(error)}") from error
    if not place.is_dir():
        raise InputError(f"{option} {target} cannot be made: {cause(_error(errno.EEXIST))}")
    if trouble := unwritable(place):
        raise OutputError(f"{option} {target} cannot be written: {trouble}")
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError(f"{option} {target} cannot be written: {cause(_error(errno.EACCES))}")


def _error(number: int) -> OSError:
    return OSError(number, os.strerror(number))


def _refuse_device(name: str, target: Path) -> None:
    """A file that takes its place would be there instead of /dev/null for every program of this machine.

    Raises:
        InputError: `target` is a device or a pipe, also by another name, as /dev/stdout is.
    """
    by_number = target.is_symlink() and os.readlink(target).startswith("/proc/")
    if by_number or (target.exists() and not target.is_file() and not target.is_dir()):
        raise InputError(f"{name} is a device or a pipe, not a file: name a file")


def check_picture(target: Path, *, option: str) -> None:
    """The same of a PNG.

    Raises:
        InputError: as `check_place`, or its name does not say what it is.
    """
    if target.suffix != ".png":
        raise InputError(f"{option} is {target}; the picture's name must end in .png")
    check_place(target, option=option)


def unwritable(folder: Path) -> str:
    """Why nothing more goes onto the disk of `folder`, and how to fix it; empty where there is room."""
    try:
        disk = os.statvfs(folder)
    except OSError as error:
        return cause(error)
    free_blocks = disk.f_bavail if os.geteuid() else disk.f_bfree  # some of it may be kept for root
    if disk.f_flag & os.ST_RDONLY:
        return cause(_error(errno.EROFS))
    if free_blocks * disk.f_frsize < LEAST_FREE_BYTES:
        return cause(_error(errno.ENOSPC))
    return ""


def _beside(place: Path) -> Path:
    """A folder on the disk of `place`: its own, but where `place` is a disk, or lies where this user may not write."""
    inside = place.is_dir() and (place.is_mount() or not os.access(place.parent, os.W_OK))
    return place if inside else place.parent


def _move(made: Path, to: Path) -> None:
    """Into its place; a folder into one that is there is put in file by file."""
    if made.is_dir() and to.is_dir():
        for inner in sorted(made.iterdir()):
            _move(inner, to / inner.name)
    else:
        made.replace(to)
