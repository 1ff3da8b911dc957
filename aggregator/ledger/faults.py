"""What SQLite and the machine complain about, as one error that names the ledger, the cause and the fix."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from aggregator.ledger.likeness import may_be_ledger, no_ledger
from conveyor.errors import LedgerError, NoLedgerError, StorageError
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
_NO_SQLITE = "not a database"
"""What SQLite says of a file whose header is none of its own."""
_FIXES = (
    (_NO_SQLITE, "its header is damaged; `tuberline ledger repair` saves what is intact"),
    (
        "malformed",
        "its pages are damaged; `tuberline ledger check` lists the damage, `tuberline ledger repair` saves what is "
        "intact",
    ),
    ("never changed", "something tried to change a committed row"),
    ("UNIQUE constraint", "a fact was to be written twice; this is a fault of the program"),
)


DAMAGE = (sqlite3.Error, UnicodeDecodeError)
"""What SQLite raises on damaged pages: damaged text breaks even its error messages."""


@contextmanager
def explained(path: Path, doing: str) -> Iterator[None]:
    """Turn an SQLite error inside the block into a LedgerError that says what was being done to `path`; into a
    StorageError where the disk or another process is in the way, into a NoLedgerError where the file is none."""
    try:
        yield
    except sqlite3.Error as error:
        for sign, fix in _PASSING:
            if sign in str(error):
                why = (unwritable(path.parent) if sign in _OF_THE_DISK else "") or fix
                raise StorageError(f"ledger {path} ({doing}): {error}: {why}") from error
        if _NO_SQLITE in str(error) and path.is_file() and not may_be_ledger(path):
            raise NoLedgerError(no_ledger(path)) from error
        fix = next((text for sign, text in _FIXES if sign in str(error)), "see `tuberline ledger check`")
        raise LedgerError(f"ledger {path} ({doing}): {error}: {fix}") from error
    except UnicodeDecodeError as error:
        raise LedgerError(f"ledger {path} ({doing}): its text is damaged; see `tuberline ledger check`") from error
