"""The ledger's tables. Rows are written once, carry a checksum and are never changed; but for a run's `total`, which
moves on by one with each transaction.

A row's `crc` is the CRC-32 of its other columns as one MessagePack list, in the order given here.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgpack

SCHEMA_VERSION = 2
OLDEST_VERSION = 1
"""Read as it is, and brought up to date when it is written to (`aggregator.ledger.migrate`)."""
APPLICATION_ID = 0x54554252
"""'TUBR' in the file's header: this SQLite file is a ledger."""


@dataclass(frozen=True, slots=True)
class Table:
    """One table: its columns (name and SQL type, without `crc`) and its key."""

    name: str
    columns: tuple[tuple[str, str], ...]
    key: str

    @property
    def names(self) -> tuple[str, ...]:
        """Column names without `crc`."""
        return tuple(name for name, _ in self.columns)

    @property
    def create(self) -> str:
        """SQL that makes the table."""
        columns = ", ".join(f"{name} {kind}" for name, kind in self.columns)
        return f"CREATE TABLE {self.name} ({columns}, crc INTEGER NOT NULL, PRIMARY KEY ({self.key})) STRICT"

    @property
    def insert(self) -> str:
        """SQL that adds a row; values as `row` makes them."""
        marks = ", ".join("?" * (len(self.columns) + 1))
        return f"INSERT INTO {self.name} ({', '.join(self.names)}, crc) VALUES ({marks})"

    @property
    def select(self) -> str:
        """SQL that reads all columns, `crc` last."""
        return f"SELECT {', '.join(self.names)}, crc FROM {self.name}"


def row(values: Sequence[Any]) -> tuple[Any, ...]:
    """The values of a row with their checksum."""
    return (*values, checksum(values))


def checksum(values: Sequence[Any]) -> int:
    """CRC-32 of a row's columns; -0.0 counts as the 0.0 that SQLite gives back for it."""
    return zlib.crc32(msgpack.packb([value + 0.0 if isinstance(value, float) else value for value in values]))


RUN = Table(
    "run",
    (
        ("run", "TEXT NOT NULL"),
        ("line", "TEXT NOT NULL"),
        ("cameras", "TEXT NOT NULL"),
        ("fingerprint", "TEXT NOT NULL"),
        ("version", "TEXT NOT NULL"),
        ("started_ns", "INTEGER NOT NULL"),
    ),
    "run",
)
ENTRY = Table(
    "entry",
    (
        ("run", "TEXT NOT NULL"),
        ("camera", "TEXT NOT NULL"),
        ("n", "INTEGER NOT NULL"),
        ("kind", "TEXT NOT NULL"),
        ("late_from_x_m", "REAL NOT NULL"),
        ("payload", "BLOB NOT NULL"),
    ),
    "run, camera, n",
)
TUBER = Table(
    "tuber",
    (
        ("run", "TEXT NOT NULL"),
        ("tuber_id", "INTEGER NOT NULL"),
        ("crossed_ns", "INTEGER NOT NULL"),
        ("place_x_m", "REAL NOT NULL"),
        ("place_y_m", "REAL NOT NULL"),
        ("weight_g", "REAL NOT NULL"),
        ("low_g", "REAL NOT NULL"),
        ("high_g", "REAL NOT NULL"),
        ("length_mm", "REAL NOT NULL"),
        ("width_mm", "REAL NOT NULL"),
        ("height_mm", "REAL NOT NULL"),
        ("views", "INTEGER NOT NULL"),
        ("method", "TEXT NOT NULL"),
        ("model", "TEXT NOT NULL"),
        ("flags", "TEXT NOT NULL"),
        ("cameras", "TEXT NOT NULL"),
        ("tracks", "TEXT NOT NULL"),
    ),
    "run, tuber_id",
)
OBSERVATION = Table(
    "observation",
    (
        ("run", "TEXT NOT NULL"),
        ("camera", "TEXT NOT NULL"),
        ("n", "INTEGER NOT NULL"),
        ("track_id", "TEXT NOT NULL"),
        ("role", "TEXT NOT NULL"),
        ("tuber_id", "INTEGER"),
        ("place_x_m", "REAL NOT NULL"),
        ("place_y_m", "REAL NOT NULL"),
        ("first_seq", "INTEGER NOT NULL"),
        ("last_seq", "INTEGER NOT NULL"),
    ),
    "run, camera, n",
)
COVERAGE = Table(
    "coverage",
    (
        ("run", "TEXT NOT NULL"),
        ("camera", "TEXT NOT NULL"),
        ("n", "INTEGER NOT NULL"),
        ("captured_ns", "INTEGER NOT NULL"),
        ("travel_m", "REAL NOT NULL"),
        ("travel_estimated", "INTEGER NOT NULL"),
        ("complete_place_x_m", "REAL NOT NULL"),
        ("final", "INTEGER NOT NULL"),
        ("looked_at_m", "REAL NOT NULL"),
        ("travelled_m", "REAL NOT NULL"),
    ),
    "run, camera, n",
)
BATCH = Table(
    "batch",
    (
        ("seq", "INTEGER NOT NULL"),
        ("run", "TEXT NOT NULL"),
        ("watermark_x_m", "REAL NOT NULL"),
        ("entries", "INTEGER NOT NULL"),
        ("tubers", "INTEGER NOT NULL"),
        ("observations", "INTEGER NOT NULL"),
    ),
    "seq",
)
SUMMARY = Table("summary", (("run", "TEXT NOT NULL"), ("payload", "TEXT NOT NULL")), "run")

TOTAL = Table("total", (("run", "TEXT NOT NULL"), ("step", "INTEGER NOT NULL"), ("payload", "TEXT NOT NULL")), "run")
"""The sums of a run, carried along in each of its transactions (`aggregator.ledger.sums`); `step` counts them."""

WRITTEN_ONCE: tuple[Table, ...] = (RUN, ENTRY, TUBER, OBSERVATION, COVERAGE, BATCH, SUMMARY)
TABLES: tuple[Table, ...] = (*WRITTEN_ONCE, TOTAL)

INDEXES: tuple[str, ...] = (
    "CREATE UNIQUE INDEX observation_once ON observation (run, track_id) WHERE role != 'repeat'",
    "CREATE INDEX observation_tuber ON observation (run, tuber_id)",
    "CREATE INDEX batch_run ON batch (run, seq)",
    "CREATE INDEX tuber_place ON tuber (run, place_x_m)",
)


def total_definition() -> list[str]:
    """SQL that makes `total` and what guards it: a row takes one step after the other and is never removed."""
    return [
        TOTAL.create,
        "CREATE TRIGGER total_update BEFORE UPDATE ON total WHEN NEW.run != OLD.run OR NEW.step != OLD.step + 1 "
        "BEGIN SELECT RAISE(ABORT, 'rows of total are never changed but by the next step'); END",
        _never("total", "DELETE"),
    ]


def definition() -> list[str]:
    """All SQL statements of an empty ledger: tables, indexes, and triggers that keep rows as they were written."""
    return [
        *(table.create for table in WRITTEN_ONCE),
        *INDEXES,
        *(_never(table.name, verb) for table in WRITTEN_ONCE for verb in ("UPDATE", "DELETE")),
        *total_definition(),
        f"PRAGMA application_id = {APPLICATION_ID}",
        f"PRAGMA user_version = {SCHEMA_VERSION}",
    ]


def _never(table: str, verb: str) -> str:
    return (
        f"CREATE TRIGGER {table}_{verb.lower()} BEFORE {verb} ON {table} "
        f"BEGIN SELECT RAISE(ABORT, 'rows of {table} are never changed'); END"
    )
