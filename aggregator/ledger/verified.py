"""The only way to a ledger's rows: every row that is read is checked against its checksum first.

Each reader of a ledger, a command, a query or the aggregator going on with it, holds a `LedgerView` and no connection.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from aggregator.ledger.faults import DAMAGE, explained
from aggregator.ledger.likeness import may_be_ledger
from aggregator.ledger.receipt import is_being_written, read_receipt, receipt_path
from aggregator.ledger.schema import (
    APPLICATION_ID,
    BATCH,
    OLDEST_VERSION,
    SCHEMA_VERSION,
    TABLES,
    Table,
    checksum,
)
from conveyor.errors import LedgerError, NoLedgerError, UnmadeError

Row = tuple[Any, ...]
OnRows = Callable[[str, int, int | None], None]
"""Called with what is read, how many rows of it are, and how many there are (None: no one knows)."""
TOLD_EVERY = 500
_ID_AT = 68
"""Where an SQLite file has its application id."""

_on_rows: ContextVar[OnRows | None] = ContextVar("on_rows", default=None)


@contextmanager
def told_rows(on_rows: OnRows) -> Iterator[None]:
    """Within this block `on_rows` hears how far every reading of a ledger is: for people who wait."""
    token = _on_rows.set(on_rows)
    try:
        yield
    finally:
        _on_rows.reset(token)


class LedgerView:
    """Reads the ledger at `path` through an open connection; `version` is that of its schema."""

    def __init__(self, db: sqlite3.Connection, path: Path, *, receipt: Callable[[], int | None] | None = None) -> None:
        self._db = db
        self.receipt = receipt or (lambda: read_receipt(receipt_path(path)))
        """The last acknowledged batch, as it was when this view began; raises LedgerError where that is damaged."""
        self.path = path
        self.version = checked_version(db, path)

    def rows(self, table: Table, where: str = "", arguments: Sequence[Any] = ()) -> Iterator[Row]:
        """Rows of `table` without their checksum, each verified.

        Args:
            where: SQL after the table's name, e.g. 'WHERE run = ? ORDER BY n'.

        Raises:
            LedgerError: a row that is not as it was written, or pages that cannot be read; says which, and the fix.
        """
        for found, sound in self.scan(table, where, arguments):
            if not sound:
                raise LedgerError(
                    f"ledger {self.path}: the row of table {table.name} with {named_key(table, found)} is not as it "
                    "was written (its checksum is wrong); `tuberline ledger check` lists all damage, `tuberline ledger "
                    f"repair {self.path}` saves what is intact into a new file and keeps this one"
                )
            yield found

    def row(self, table: Table, where: str, arguments: Sequence[Any] = ()) -> Row | None:
        """The first row that `rows` gives, or None."""
        return next(self.rows(table, f"{where} LIMIT 1", arguments), None)

    def scan(self, table: Table, where: str = "", arguments: Sequence[Any] = ()) -> Iterator[tuple[Row, bool]]:
        """Rows without their checksum, and whether it is right: for who lists damage or saves what is left."""
        if self.version < table.since:
            return
        on_rows = None if "LIMIT" in where else _on_rows.get()
        with explained(self.path, f"reading table {table.name}"):
            total = None if on_rows is None else self._count(table, where, arguments)
            found = self._db.execute(f"{table.select(self.version)} {where}", arguments)
            for n, (*columns, crc) in enumerate(found):
                if on_rows is not None and n % TOLD_EVERY == 0:
                    on_rows(f"ledger: {table.name}", n, total)
                yield tuple(columns), checksum(columns) == crc

    def _count(self, table: Table, where: str, arguments: Sequence[Any]) -> int:
        (count,) = self._db.execute(f"SELECT count(*) FROM {table.name} {where}", arguments).fetchone()
        return int(count)

    def tally(self, sql: str) -> list[Row]:
        """Counts over columns of rows: for the check of what rows say of each other, after each was verified."""
        with explained(self.path, "counting rows"):
            return list(self._db.execute(sql))

    def last_seq(self) -> int:
        """Number of the newest batch; 0 where there is none."""
        found = self.row(BATCH, "ORDER BY seq DESC")
        return 0 if found is None else int(found[0])

    def pragma(self, name: str) -> list[Row]:
        """The answer of an SQLite check or setting; damage is told, not raised."""
        if (on_rows := _on_rows.get()) is not None:
            on_rows("ledger: pages", 0, None)
        try:
            return list(self._db.execute(f"PRAGMA {name}"))
        except DAMAGE as error:
            return [(str(error),)]


def named_key(table: Table, found: Row) -> str:
    """The key of a row in words, e.g. "run 'r', tuber_id 3"."""
    return ", ".join(f"{name} {str(found[table.names.index(name)])[:80]!r}" for name in table.key.split(", "))


def checked_version(db: sqlite3.Connection, path: Path) -> int:
    """The schema version of a ledger.

    Raises:
        LedgerError: not a ledger, or of a version that this program does not know.
    """
    (application,) = db.execute("PRAGMA application_id").fetchone()
    (version,) = db.execute("PRAGMA user_version").fetchone()
    if application == 0 and db.execute("SELECT 1 FROM sqlite_master").fetchone() is None:
        raise unmade(path)
    if application != APPLICATION_ID:
        kind = LedgerError if may_be_ledger(path) else NoLedgerError
        raise kind(f"{path} is an SQLite file, but no ledger of Tuberline (application id {application:#x})")
    if not OLDEST_VERSION <= version <= SCHEMA_VERSION:
        raise LedgerError(
            f"ledger {path} has schema version {version}, this program knows version {SCHEMA_VERSION} and reads from "
            f"{OLDEST_VERSION}: use the Tuberline that wrote it, or start a new ledger"
        )
    tables = {name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    missing = [t.name for t in TABLES if t.name not in tables and t.since <= version]
    if missing:
        raise LedgerError(
            f"ledger {path} lacks its tables {', '.join(missing)}: its schema is damaged; `tuberline ledger repair "
            f"{path}` saves what is intact into a new file and keeps this one"
        )
    return int(version)


def _is_being_made(path: Path) -> bool:
    """A journal of SQLite's lies beside a ledger only until the file has its header; then it has a write-ahead log."""
    if not path.with_name(f"{path.name}-journal").exists():
        return False
    with path.open("rb") as file:
        return file.read(_ID_AT + 4)[_ID_AT:] != APPLICATION_ID.to_bytes(4, "big")


def unmade(path: Path) -> LedgerError:
    """That nothing is in the file, why, and what to do.

    Raises:
        LedgerError: the receipt beside it is damaged.
    """
    if acknowledged := read_receipt(receipt_path(path)):
        return LedgerError(
            f"ledger {path} is empty, but {acknowledged} batches of it were acknowledged: the file was lost; bring it "
            f"back, or remove {receipt_path(path)} too and start again"
        )
    return UnmadeError(
        f"ledger {path} is empty. Either its aggregator was stopped before it had made it: nothing was counted, start "
        f"the line again. Or it was copied without what belongs to it: copy {path.name}-wal and "
        f"{receipt_path(path).name} with it, or copy it after the line was stopped"
    )


def _receipt_now(path: Path) -> Callable[[], int | None]:
    try:
        acknowledged = read_receipt(receipt_path(path))
    except LedgerError as error:
        text = str(error)

        def damaged() -> int | None:
            raise LedgerError(text)

        return damaged
    return lambda: acknowledged


def _has_log(path: Path) -> bool:
    """Whether there is a write-ahead log to be read with the ledger. A writer that found no room on the disk leaves an
    empty one, and with that SQLite could read no more than the writer could write.
    """
    log = path.with_name(path.name + "-wal")
    return log.exists() and (log.stat().st_size > 0 or is_being_written(path))


@contextmanager
def reading(path: Path) -> Iterator[LedgerView]:
    """The ledger at `path`, read-only, also while it is being written: all reads see one and the same moment.

    Raises:
        LedgerError: no ledger, of another version, or unreadable.
    """
    if not path.is_file():
        raise LedgerError(f"there is no ledger at {path}; give a run's folder or its ledger.db")
    immutable = "" if _has_log(path) else "&immutable=1"
    with explained(path, "reading"):
        if _is_being_made(path):
            raise unmade(path)
        receipt = _receipt_now(path)  # before the view's moment: the batches that it tells of are in the view
        db = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro{immutable}", uri=True, isolation_level=None)
        try:
            db.execute("BEGIN")
            yield LedgerView(db, path, receipt=receipt)
        finally:
            db.close()
