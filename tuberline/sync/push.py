"""From a ledger into the database: what is committed there is there once, whatever is cut in the middle.

Tubers go by their number, a batch in a transaction; the newest number in the database is where the next sync goes on.
Each tuber carries a checksum of its ledger row, by which a database that holds another ledger's tubers is noticed.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import islice
from pathlib import Path
from typing import Any

import msgpack

from aggregator.ledger.line_tickets import tickets_beside
from aggregator.ledger.load_rows import read_book
from aggregator.ledger.load_totals import ReadLoads
from aggregator.ledger.reader import LedgerView, RunRow, ledger_file, read_runs, read_summary, read_tubers, reading
from aggregator.ledger.schema import LOAD_EVENT, checksum
from aggregator.ledger.totals_by import labelled, together_of
from conveyor.errors import InputError, LinkError, TakenError
from conveyor.extras import install_hint
from conveyor.messages import Tuber
from conveyor.messages.base import plain
from tuberline.sync.schema import LOCK, NEWEST, SCHEMA, STATEMENTS, VERSION

BATCH = 2000
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
CONNECT_WITHIN_S = 10
SILENT_S = 20
"""A link that was cut without a word is given up after this, by us and by the server: else its open transaction would
hold the tables until TCP gives up, hours later."""
LOCK_S = 2 * SILENT_S
"""So long tables, or another sync of the same ledger, are waited for."""
_LINK: dict[str, Any] = {
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 2,
    "tcp_user_timeout": SILENT_S * 1000,
}
_SERVER = {
    "idle_in_transaction_session_timeout": f"{SILENT_S}s",
    "lock_timeout": f"{LOCK_S}s",
    "tcp_keepalives_idle": "10",
    "tcp_keepalives_interval": "5",
    "tcp_keepalives_count": "2",
}
UP_TO_DATE = (
    f"SELECT to_regclass('{SCHEMA}.told') IS NOT NULL AND EXISTS (SELECT FROM pg_attribute WHERE "
    f"attrelid = to_regclass('{SCHEMA}.load') AND attname = '{NEWEST}' AND NOT attisdropped)"
)
COLUMNS = (
    "run_id, tuber, crossed_at, weight_g, low_g, high_g, length_mm, width_mm, height_mm, place_x_m, place_y_m, views, "
    "method, model, flags, crc"
)


@dataclass(slots=True)
class Pushed:
    """What one sync brought: new tubers, runs and loads of a ledger."""

    tubers: int = 0
    runs: int = 0
    loads: int = 0


def connect(url: str) -> Any:
    """A connection to the database, with the tables made.

    Raises:
        InputError: psycopg is not installed, `url` is none, or the tables are of another version.
        LinkError: the server cannot be reached now.
    """
    try:
        import psycopg
    except ImportError as error:
        raise InputError(f"sync needs psycopg, which is not installed; {install_hint('sync')}") from error
    if not url.startswith(("postgresql://", "postgres://")):
        raise InputError("sync takes postgresql://user@host/database; a password comes from PGPASSWORD or ~/.pgpass")
    try:
        options = " ".join(f"-c {name}={value}" for name, value in _SERVER.items())
        connection = psycopg.connect(url, connect_timeout=CONNECT_WITHIN_S, autocommit=True, options=options, **_LINK)
        if connection.execute(UP_TO_DATE).fetchone() != (True,):
            with connection.transaction():
                connection.execute("SELECT pg_advisory_xact_lock(%s)", (LOCK,))
                for statement in STATEMENTS:
                    connection.execute(statement)
        row = connection.execute(f"SELECT version FROM {SCHEMA}.version").fetchone()
    except psycopg.OperationalError as error:
        raise LinkError(f"the database cannot be reached: {_first_line(error)}") from error
    except psycopg.Error as error:
        raise InputError(f"the database refuses the tables of Tuberline: {_first_line(error)}") from error
    if row is None or row[0] != VERSION:
        connection.close()
        raise InputError(
            f"the database has tables of version {row and row[0]}, this program knows {VERSION}: update it"
        )
    return connection


def push(connection: Any, path: Path) -> Pushed:
    """Bring what a ledger holds and the database does not.

    Raises:
        LinkError: the connection was cut; what was committed is there, and the next sync goes on.
        InputError: the database holds other tubers under this line's and run's name, or later words of its loads.
        LedgerError: the ledger cannot be trusted.
        TakenError: another sync brings this ledger, and has not ended within 40 s.
    """
    import psycopg

    file = ledger_file(path)
    pushed = Pushed()
    try:
        with _alone(connection, file), reading(file) as view:
            with connection.transaction():
                begun = [_begun(connection, view, run) for run in read_runs(view)]
                run_ids = [run.run_id for run in begun]
                _refuse_older(connection, view, run_ids)
            for run in begun:
                pushed.runs += 1
                pushed.tubers += _tubers(connection, view, run)
            if run_ids:
                pushed.loads = _loads(connection, view, run_ids)
    except psycopg.OperationalError as error:
        raise LinkError(f"the database went away: {_first_line(error)}; what was committed is there") from error
    except psycopg.Error as error:
        raise InputError(f"the database refused what ledger {file} holds: {_first_line(error)}") from error
    return pushed


@contextmanager
def _alone(connection: Any, file: Path) -> Iterator[None]:
    """Within this block no other sync brings this ledger: what it read before we wrote must not take the place of that.

    Entered before the ledger is read, and so with what another sync that has just ended has brought. The server lets go
    of it with our connection.
    """
    import psycopg

    with reading(file) as view:
        runs = read_runs(view)
    if not runs:
        yield
        return
    told = repr((runs[0].line, runs[0].run, runs[0].started_ns)).encode()  # of a ledger's copies too
    key = int.from_bytes(hashlib.blake2b(told, digest_size=8).digest(), signed=True)
    try:
        connection.execute("SELECT pg_advisory_lock(%s)", (key,))
    except psycopg.errors.LockNotAvailable as error:
        raise TakenError(
            f"ledger {file} is being synced by another process for more than {LOCK_S} s: let that one end, or stop it"
        ) from error
    try:
        yield
    finally:
        with suppress(psycopg.Error):  # the link was cut, and the lock with it
            connection.execute("SELECT pg_advisory_unlock(%s)", (key,))


@dataclass(frozen=True, slots=True)
class _Begun:
    """A run of the ledger, its id in the database, and the newest of its tubers that is there."""

    run: RunRow
    run_id: int
    newest: int


def _begun(connection: Any, view: LedgerView, run: RunRow) -> _Begun:
    (run_id,) = connection.execute(
        f"""INSERT INTO {SCHEMA}.run (line, run, started_ns, started_at, cameras, version, summary)
        VALUES (%s, %s, %s, %s, %s, %s, %s)
        ON CONFLICT (line, run, started_ns) DO UPDATE SET summary = coalesce(excluded.summary, run.summary)
        RETURNING id""",
        (
            run.line,
            run.run,
            run.started_ns,
            _at(run.started_ns),
            list(run.cameras),
            run.version,
            read_summary(view, run.run),
        ),
    ).fetchone()
    return _Begun(run, run_id, _newest(connection, view, run, run_id))


def _newest(connection: Any, view: LedgerView, run: RunRow, run_id: int) -> int:
    """The number of the newest tuber in the database; 0 where none is there."""
    newest = connection.execute(
        f"SELECT tuber, crc FROM {SCHEMA}.tuber WHERE run_id = %s ORDER BY tuber DESC LIMIT 1", (run_id,)
    ).fetchone()
    if newest is None:
        return 0
    number, crc = newest
    same = next(read_tubers(view, run.run, since=number - 1, limit=1), None)
    if same is None:
        raise InputError(
            f"ledger {view.path} lacks tuber {number} of run {run.run} of line {run.line}, which the database "
            "holds: it is an older copy of another ledger, or damaged; sync the one that has it. "
            f"{_of_two_lines(run.line)}"
        )
    if same.tuber_id != number or _crc(same) != crc:
        raise InputError(
            f"the database holds another tuber {number} of run {run.run} of line {run.line}: it was synced from "
            f"another ledger. {_of_two_lines(run.line)}. Where that ledger counts no more, {_afresh(run_id)}"
        )
    return int(number)


def _refuse_older(connection: Any, view: LedgerView, run_ids: Sequence[int]) -> None:
    """A copy of a ledger may have all of its tubers, and lack what was said of its loads since: a ticket, a note."""
    found = connection.execute(
        f"SELECT event, crc, ledger FROM {SCHEMA}.told WHERE ledger = ANY(%s) ORDER BY event DESC LIMIT 1",
        (list(run_ids),),
    ).fetchone()
    if found is None:
        _refuse_without_tickets(connection, view, run_ids)
        return
    event, crc, run_id = found
    same = view.row(LOAD_EVENT, "WHERE n = ?", (event,))
    if same is None or checksum(same) != crc:
        raise InputError(
            f"ledger {view.path} lacks what was said last of the loads in the database (event {event}: a start, an "
            f"end, a ticket or a note): {_older_copy(run_id)}"
        )


def _refuse_without_tickets(connection: Any, view: LedgerView, run_ids: Sequence[int]) -> None:
    """The same of loads that were synced before there was `NEWEST`: a ticket there is one that the ledger was told at
    some time.
    """
    loads = read_book(view).loads.values()
    told_kg = {t.ticket_g / 1000 for load in loads for t in load.tickets if t.net and t.ticket_g is not None}
    there = connection.execute(
        f"SELECT load, ticket_kg, ledger FROM {SCHEMA}.load WHERE ledger = ANY(%s) ORDER BY place", (list(run_ids),)
    )
    for load, kg, run_id in there:
        if kg is not None and kg not in told_kg:
            raise InputError(
                f"ledger {view.path} lacks the ticket of {kg:g} kg of load '{load}' in the database: "
                f"{_older_copy(run_id)}"
            )


def _older_copy(run_id: int) -> str:
    return (
        "it is a copy of another ledger; sync the one that has it, which `tuberline load show` lists, or, if that is "
        f"gone, {_afresh(run_id)}"
    )


def _of_two_lines(name: str) -> str:
    """What helps where two lines are called alike: to delete the run would take the other line's tubers."""
    return (
        f"Where it is of another line that is called {name}, too, and began a run in the same moment, give one of them "
        "a name of its own (name in the line's file; its next run has it), and sync this run into a database of its "
        "own: `tuberline ledger totals` adds up both"
    )


def _afresh(run_id: int) -> str:
    return f"delete that run there (DELETE FROM {SCHEMA}.run WHERE id = {run_id}) and sync again"


def _tubers(connection: Any, view: LedgerView, run: _Begun) -> int:
    count = 0
    for batch in batched_tubers(view, run.run, run.newest):
        copying = f"COPY {SCHEMA}.tuber ({COLUMNS}) FROM STDIN"
        with connection.transaction(), connection.cursor() as cursor, cursor.copy(copying) as copy:
            for tuber in batch:
                copy.write_row(_row(run.run_id, tuber))
        count += len(batch)
    return count


def batched_tubers(view: LedgerView, run: RunRow, since: int) -> Iterator[tuple[Tuber, ...]]:
    """Tubers of a run after number `since`, a transaction's worth at a time."""
    tubers = read_tubers(view, run.run, since=since)
    while batch := tuple(islice(tubers, BATCH)):
        yield batch


def _loads(connection: Any, view: LedgerView, run_ids: Sequence[int]) -> int:
    """All loads of a ledger in place of those the database had: a note or a ticket may have changed any of them.

    They go under the run that began first. Which one that is changes where a clock was set back: so those under any
    run of the ledger go.
    """
    ledger = ReadLoads(view)
    tickets = tickets_beside(ledger)
    rows = []
    for place, load in enumerate(labelled(ledger, tickets)):
        sums, raw_g = together_of([load])
        labels = load.labels
        grams = (raw_g, sums.estimated_g, sums.low_g, sums.high_g)
        rows.append(
            (
                ledger.runs[load.run].line,
                run_ids[0],
                place,
                labels["load"],
                labels["field"],
                labels["variety"],
                labels["day"],
                sums.tubers,
                *(g / 1000 if sums.saw else None for g in grams),  # none where no belt was seen, which is not 0 kg
                sums.coverage,
                None if load.net_g is None else load.net_g / 1000,
                load.is_load,
            )
        )
    with connection.transaction(), connection.cursor() as cursor:
        cursor.execute(f"DELETE FROM {SCHEMA}.load WHERE ledger = ANY(%s)", (list(run_ids),))
        cursor.executemany(f"INSERT INTO {SCHEMA}.load VALUES ({', '.join(['%s'] * 15)})", rows)
        cursor.execute(f"DELETE FROM {SCHEMA}.told WHERE ledger = ANY(%s)", (list(run_ids),))
        if (newest := view.row(LOAD_EVENT, "ORDER BY n DESC")) is not None:
            cursor.execute(f"INSERT INTO {SCHEMA}.told VALUES (%s, %s, %s)", (run_ids[0], newest[0], checksum(newest)))
    return len(rows)


def _row(run_id: int, tuber: Tuber) -> tuple[Any, ...]:
    return (
        run_id,
        tuber.tuber_id,
        _at(tuber.crossed_ns),
        tuber.weight_g,
        tuber.low_g,
        tuber.high_g,
        tuber.length_mm,
        tuber.width_mm,
        tuber.height_mm,
        tuber.place_x_m,
        tuber.place_y_m,
        tuber.views,
        tuber.method,
        tuber.model,
        list(tuber.flags),
        _crc(tuber),
    )


def _crc(tuber: Tuber) -> int:
    return zlib.crc32(msgpack.packb(plain(tuber)))


def _at(unix_ns: int) -> datetime:
    return EPOCH + timedelta(microseconds=unix_ns // 1000)


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
