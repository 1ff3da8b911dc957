"""The ledger's tables. Rows are written once, carry a checksum and are never changed; but for the sums of a run
(`total`) and of a stretch of its belt (`load_total`), which move on by one with each transaction.

A row's `crc` is the CRC-32 of its other columns as one MessagePack list, in the order given here; without the columns
at its end that hold nothing, so that a column added later changes no row that was written before.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgpack

SCHEMA_VERSION = 4
OLDEST_VERSION = 1
"""Read as it is, and brought up to date when it is written to (`aggregator.ledger.migrate`)."""
APPLICATION_ID = 0x54554252
"""'TUBR' in the file's header: this SQLite file is a ledger."""

_NAMES_OF_VERSION_1 = {("batch", "watermark_x_m"): "line_x_m"}


@dataclass(frozen=True, slots=True)
class Table:
    """One table: its columns (name and SQL type, without `crc`), its key, and the schema version it came with.

    `added`: columns that came later, each with its version; such columns stand last and may hold nothing.
    """

    name: str
    columns: tuple[tuple[str, str], ...]
    key: str
    since: int = 1
    added: tuple[tuple[str, int], ...] = ()

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

    def select(self, version: int) -> str:
        """SQL that reads all columns, `crc` last, from a ledger of `version`: those it lacks as NULL."""
        names = [
            _NAMES_OF_VERSION_1.get((self.name, name), name) if version == 1 else name
            for name in self.names
            if dict(self.added).get(name, 1) <= version
        ]
        lacking = ["NULL"] * (len(self.names) - len(names))
        return f"SELECT {', '.join([*names, *lacking, 'crc'])} FROM {self.name}"

    def additions(self, version: int) -> list[str]:
        """SQL that adds the columns which came after `version`."""
        kinds = dict(self.columns)
        later = [name for name, since in self.added if self.since <= version < since]
        return [f"ALTER TABLE {self.name} ADD COLUMN {name} {kinds[name]}" for name in later]


def row(values: Sequence[Any]) -> tuple[Any, ...]:
    """The values of a row with their checksum; -0.0 as 0.0, which is what SQLite gives back."""
    values = [value + 0.0 if isinstance(value, float) else value for value in values]
    return (*values, checksum(values))


def checksum(values: Sequence[Any]) -> int:
    """CRC-32 of a row's columns; None at its end counts for nothing, and -0.0 as the 0.0 that SQLite gives back."""
    return zlib.crc32(packed(values))


def packed(values: Sequence[Any]) -> bytes:
    """What the checksum of a row is made of; damaged text with the bytes that it has."""
    said = [value + 0.0 if isinstance(value, float) else value for value in values]
    while said and said[-1] is None:
        said.pop()
    data: bytes = msgpack.packb(said, unicode_errors="surrogateescape")
    return data


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
SIZE_COLUMNS = tuple(
    f"{prefix}{name}{suffix}_mm"
    for suffix in ("", "_sd")
    for prefix, name in (("caliper_", "length"), ("caliper_", "width"), ("caliper_", "thickness"), ("", "mesh"))
)
"""Of `conveyor.messages.Sizes`, in its order; NULL where nothing is said, as in ledgers before version 4."""
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
        *((name, "REAL") for name in (*SIZE_COLUMNS, "log_odds")),
    ),
    "run, tuber_id",
    added=tuple((name, 4) for name in (*SIZE_COLUMNS, "log_odds")),
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
FOREIGN = Table(
    "foreign_body",
    (
        ("run", "TEXT NOT NULL"),
        ("body_id", "INTEGER NOT NULL"),
        ("crossed_ns", "INTEGER NOT NULL"),
        ("place_x_m", "REAL NOT NULL"),
        ("place_y_m", "REAL NOT NULL"),
        ("kind", "TEXT NOT NULL"),
        ("length_mm", "REAL NOT NULL"),
        ("width_mm", "REAL NOT NULL"),
        ("height_mm", "REAL NOT NULL"),
        ("volume_ml", "REAL NOT NULL"),
        ("cameras", "TEXT NOT NULL"),
        ("tracks", "TEXT NOT NULL"),
        ("log_odds", "REAL"),
    ),
    "run, body_id",
    since=4,
)
"""Clods, stones and haulm that were refused."""
SUMMARY = Table("summary", (("run", "TEXT NOT NULL"), ("payload", "TEXT NOT NULL")), "run")

LOAD_EVENT = Table(
    "load_event",
    (
        ("n", "INTEGER NOT NULL"),
        ("run", "TEXT NOT NULL"),
        ("request", "TEXT NOT NULL"),
        ("kind", "TEXT NOT NULL"),
        ("load", "INTEGER NOT NULL"),
        ("place_x_m", "REAL"),
        ("said_ns", "INTEGER NOT NULL"),
        ("said_by", "TEXT NOT NULL"),
        ("payload", "TEXT NOT NULL"),
    ),
    "n",
    since=3,
)
"""What was said of loads, in order (`aggregator.core.loads`): all that is known of a load follows from it."""

TOTAL = Table(
    "total",
    (("run", "TEXT NOT NULL"), ("step", "INTEGER NOT NULL"), ("payload", "TEXT NOT NULL")),
    "run",
    since=2,
)
"""The sums of a run, carried along in each of its transactions (`aggregator.ledger.sums`); `step` counts them."""

LOAD_TOTAL = Table(
    "load_total",
    (
        ("run", "TEXT NOT NULL"),
        ("span", "INTEGER NOT NULL"),
        ("step", "INTEGER NOT NULL"),
        ("payload", "TEXT NOT NULL"),
    ),
    "run, span",
    since=3,
)
"""The sums of a stretch of a run's belt, from one change of loads to the next; `span` is the event that began it, 0 for
the run's beginning. There are none where no load was started: then the run is one load."""

WRITTEN_ONCE: tuple[Table, ...] = (RUN, ENTRY, TUBER, OBSERVATION, COVERAGE, BATCH, SUMMARY, LOAD_EVENT, FOREIGN)
MOVING: tuple[Table, ...] = (TOTAL, LOAD_TOTAL)
TABLES: tuple[Table, ...] = (*WRITTEN_ONCE, *MOVING)

INDEXES: tuple[str, ...] = (
    "CREATE UNIQUE INDEX observation_once ON observation (run, track_id) WHERE role != 'repeat'",
    "CREATE INDEX observation_tuber ON observation (run, tuber_id)",
    "CREATE INDEX batch_run ON batch (run, seq)",
    "CREATE INDEX tuber_place ON tuber (run, place_x_m)",
)
LOAD_INDEXES: tuple[str, ...] = (
    "CREATE UNIQUE INDEX load_event_request ON load_event (request)",
    "CREATE INDEX load_event_run ON load_event (run)",
)


def moving_definition(table: Table) -> list[str]:
    """SQL that makes a table of `MOVING` and what guards it: a row takes one step after the other and is never
    removed."""
    other = " OR ".join(f"NEW.{name} != OLD.{name}" for name in table.key.split(", "))
    return [
        table.create,
        f"CREATE TRIGGER {table.name}_update BEFORE UPDATE ON {table.name} WHEN {other} OR NEW.step != OLD.step + 1 "
        f"BEGIN SELECT RAISE(ABORT, 'rows of {table.name} are never changed but by the next step'); END",
        _never(table.name, "DELETE"),
    ]


def load_definition() -> list[str]:
    """SQL that version 3 adds."""
    return [
        LOAD_EVENT.create,
        *LOAD_INDEXES,
        *(_never(LOAD_EVENT.name, verb) for verb in ("UPDATE", "DELETE")),
        *moving_definition(LOAD_TOTAL),
    ]


def foreign_definition() -> list[str]:
    """SQL that version 4 adds, beside columns."""
    return [FOREIGN.create, *(_never(FOREIGN.name, verb) for verb in ("UPDATE", "DELETE"))]


def definition() -> list[str]:
    """All SQL statements of an empty ledger: tables, indexes, and triggers that keep rows as they were written."""
    first = [table for table in WRITTEN_ONCE if table.since == 1]
    return [
        *(table.create for table in first),
        *INDEXES,
        *(_never(table.name, verb) for table in first for verb in ("UPDATE", "DELETE")),
        *moving_definition(TOTAL),
        *load_definition(),
        *foreign_definition(),
        f"PRAGMA application_id = {APPLICATION_ID}",
        f"PRAGMA user_version = {SCHEMA_VERSION}",
    ]


def _never(table: str, verb: str) -> str:
    return (
        f"CREATE TRIGGER {table}_{verb.lower()} BEFORE {verb} ON {table} "
        f"BEGIN SELECT RAISE(ABORT, 'rows of {table} are never changed'); END"
    )
