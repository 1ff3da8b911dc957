"""Versions of Tuberline's own file formats: what states none is version 1, what is newer than we are is refused."""

from __future__ import annotations

from pathlib import Path

from conveyor import __version__
from conveyor.errors import InputError


def check_version(found: object, *, newest: int, what: str, where: Path) -> int:
    """The version that a file states: None, '2' or 2.

    Args:
        found: as it stands in the file; None where it says nothing.
        newest: that this program reads.
        what: the format's name, 'view pack'.
        where: the file.

    Raises:
        InputError: newer than `newest`, or no version at all.
    """
    if found is None:
        return 1
    try:
        version = int(found) if isinstance(found, str | int) and not isinstance(found, bool) else 0
    except ValueError:
        version = 0
    if version < 1:
        raise InputError(f"{where} states the {what} version {found!r}; versions are whole numbers from 1 on")
    if version > newest:
        raise InputError(
            f"{where} is a {what} of version {version}; this Tuberline ({__version__}) reads up to version {newest}: "
            "update Tuberline, or write the file with this one"
        )
    return version
