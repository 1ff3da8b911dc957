"""What SQLite and the machine complain about, as one error that names the ledger, the cause and the fix."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from conveyor.errors import LedgerError, StorageError
from conveyor.files import unwritable

_PASSING = (
    ("disk is full", "the disk is full; free some space and start again, nothing acknowledged is lost"),
    ("readonly", "it is read-only; give the user write access to the file and to its folder"),
    ("unable to open", "it cannot be opened; does its folder exist, and may this user read and write there?"),
    ("locked", "another process is writing to it; stop that one first"),
    ("I/O error", "the disk reports errors; copy the folder to another disk, then `tuberline ledger check`"),
)
"""What may be gone at the next start: the ledger itself is as it was."""
_OF_THE_DISK = ("readonly", "unable to open", "I/O error")
"""What SQLite says of a full disk too, where not even the memory that it shares finds room on it."""
_FIXES = (
    ("not a database", "it is not an SQLite file, or its header is damaged; `tuberline ledger check` says more"),
    ("malformed", "its pages are damaged; `tuberline ledger check` lists the damage, `repair` saves what is intact"),
    ("never changed", "something tried to change a committed row"),
    ("UNIQUE constraint", "a fact was to be written twice; this is a fault of the program"),
)


DAMAGE = (sqlite3.Error, UnicodeDecodeError)
"""What SQLite raises on damaged pages: damaged text breaks even its error messages."""


@contextmanager
def explained(path: Path, doing: str) -> Iterator[None]:
    """Turn an SQLite error inside the block into a LedgerError that says what was being done to `path`; into a
    StorageError where the disk or another process is in the way."""
    try:
        yield
    except sqlite3.Error as error:
        for sign, fix in _PASSING:
            if sign in str(error):
                why = (unwritable(path.parent) if sign in _OF_THE_DISK else "") or fix
                raise StorageError(f"ledger {path} ({doing}): {error}: {why}") from error
        fix = next((text for sign, text in _FIXES if sign in str(error)), "see `tuberline ledger check`")
        raise LedgerError(f"ledger {path} ({doing}): {error}: {fix}") from error
    except UnicodeDecodeError as error:
        raise LedgerError(f"ledger {path} ({doing}): its text is damaged; see `tuberline ledger check`") from error
