"""One flipped bit: the audit fails whatever it hit, a reader tells of it in one error, no one sees a false row."""

from __future__ import annotations

import ast
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from aggregator.calibration.load import ticket_of
from aggregator.ledger.audit import audit_run
from aggregator.ledger.check import check_file
from aggregator.ledger.export import canonical_lines, full_lines
from aggregator.ledger.load_list import told_loads
from aggregator.ledger.loads import last_loads
from aggregator.ledger.reader import read_bodies, read_sums, read_tubers, reading, the_run
from aggregator.ledger.schema import TABLES
from aggregator.ledger.totals_by import totals_by
from aggregator.ledger.verified import LedgerView
from aggregator.ledger.writer import Ledger
from conveyor.errors import InputError, LedgerError
from tests.aggregator.finished_ledger import copied, flip
from tests.conftest import ROOT

QUICK, MANY = 60, 1000
NOT_FOUND_IN_ROWS = 0.5
"""Of all bytes of a small ledger, most are in pages' unused parts: without its seal only the rows can tell."""


def sound(path: Path) -> bool:
    """What `tuberline audit` says; a LedgerError fails it too, anything else is a traceback."""
    try:
        with reading(path) as view:
            return audit_run(view, the_run(view, path, None)).balanced
    except LedgerError:
        return False


def flip_anywhere(finished: Path, folder: Path, rng: np.random.Generator, n: int) -> None:
    size = finished.stat().st_size
    for i in range(n):
        path = copied(finished, folder / str(i))
        at, bit = int(rng.integers(size)), int(rng.integers(8))
        flip(path, at, bit)
        assert not sound(path), f"the audit did not notice bit {bit} of byte {at}"
        assert check_file(path), f"the check did not notice bit {bit} of byte {at}"
        shutil.rmtree(path.parent)


def flip_in_rows(finished: Path, folder: Path, rng: np.random.Generator, n: int) -> None:
    """Flips in the values of rows, written back with valid pages: what a row's checksum alone can find."""
    db = sqlite3.connect(finished)
    places = [
        (table, column, rowid)
        for table in TABLES
        for (rowid,) in db.execute(f"SELECT rowid FROM {table.name}").fetchall()
        for column in (*table.names, "crc")
    ]
    db.close()
    for i in range(n):
        path = copied(finished, folder / str(i))
        (path.with_name("ledger.ack")).write_bytes(path.with_name("ledger.ack").read_bytes()[:8192])  # no seal
        table, column, rowid = places[int(rng.integers(len(places)))]
        told = flip_value(path, table.name, column, rowid, rng)
        assert not sound(path), f"the audit did not notice {told}"
        shutil.rmtree(path.parent)


def flip_value(path: Path, table: str, column: str, rowid: int, rng: np.random.Generator) -> str:
    db = sqlite3.connect(path, isolation_level=None)
    for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
        db.execute(f"DROP TRIGGER {name}")
    (value,) = db.execute(f"SELECT {column} FROM {table} WHERE rowid = ?", (rowid,)).fetchone()
    new = flipped(value, rng)
    try:
        db.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (new, rowid))
    except (sqlite3.IntegrityError, OverflowError):
        db.execute(f"DELETE FROM {table} WHERE rowid = ?", (rowid,))  # a key that is there already: one row less
    db.close()
    return f"{column} of row {rowid} of {table}: {value!r} became {new!r}"


def flipped(value: object, rng: np.random.Generator) -> object:
    if isinstance(value, int):
        return value ^ (1 << int(rng.integers(31)))
    if isinstance(value, float):
        bits = np.array([value]).view(np.uint64) ^ np.uint64(1 << int(rng.integers(64)))
        found = float(bits.view(np.float64)[0])
        return found if np.isfinite(found) or np.isinf(value) else -value
    if value is None:
        return 1
    data = bytearray(value if isinstance(value, bytes) else str(value).encode())
    if not data:
        return type(value)(b"x" if isinstance(value, bytes) else "x")  # type: ignore[call-arg]
    at = int(rng.integers(len(data)))
    data[at] ^= 1 << int(rng.integers(6))
    return bytes(data) if isinstance(value, bytes) else data.decode("utf-8", "replace")


def test_the_audit_of_an_undamaged_ledger_is_content(finished: Path, tmp_path: Path) -> None:
    path = copied(finished, tmp_path / "copy")
    assert check_file(path) == []
    assert sound(path)


def test_any_flipped_bit_of_a_ledger_at_rest_fails_the_audit(
    finished: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    flip_anywhere(finished, tmp_path, rng, QUICK)


def test_any_flipped_bit_in_a_row_fails_the_audit(finished: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    flip_in_rows(finished, tmp_path, rng, QUICK)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_thousand_flipped_bits_each_fail_the_audit(finished: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    flip_anywhere(finished, tmp_path / "anywhere", rng, MANY)
    flip_in_rows(finished, tmp_path / "rows", rng, MANY)


READERS: dict[str, Callable[[LedgerView, Path], object]] = {
    "tubers": lambda view, path: list(read_tubers(view, "story")),
    "canonical": lambda view, path: list(canonical_lines(view, the_run(view, path, None))),
    "export": lambda view, path: list(full_lines(view, the_run(view, path, None))),
    "runs": lambda view, path: last_loads(view, limit=5),
    "loads": lambda view, path: told_loads(view, limit=5),
    "totals by field": lambda view, path: [total.sums for total in totals_by([path], "field")[0]],
    "foreign": lambda view, path: list(read_bodies(view, "story")),
    "sums": lambda view, path: read_sums(view, "story").text(),
    "ticket": lambda view, path: ticket_of(path, run=None, ticket_g=1e3, ticket_sd_g=1.0),
}


@pytest.mark.parametrize("reader", READERS)
def test_a_reader_gives_the_truth_or_one_clear_error(
    reader: str, finished: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    """A tuber of 53.8 g was exported as one of 3,523,948 g."""

    def read(path: Path) -> object:
        with reading(path) as view:
            try:
                return READERS[reader](view, path)
            except InputError as error:
                return str(error).replace(str(path), "")

    expected, size, loud = read(finished), finished.stat().st_size, 0
    quiet = 0
    trials = QUICK * (6 if reader in ("runs", "loads", "foreign") else 1)  # they read a few rows of the file alone
    for i in range(trials):
        path = copied(finished, tmp_path / str(i))
        flip(path, int(rng.integers(size)), int(rng.integers(8)))
        try:
            assert read(path) == expected
        except LedgerError as error:
            loud += str(path) in str(error)
        else:
            quiet += 1
        shutil.rmtree(path.parent)
    assert loud > 0
    assert loud + quiet == trials, "an error that does not name the ledger"


def test_the_error_names_file_table_row_and_mend(finished: Path, tmp_path: Path) -> None:
    path = copied(finished, tmp_path / "copy")
    db = sqlite3.connect(path, isolation_level=None)
    db.execute("DROP TRIGGER tuber_update")
    db.execute("UPDATE tuber SET weight_g = 3523948 WHERE tuber_id = 4")
    db.close()
    with reading(path) as view, pytest.raises(LedgerError) as raised:
        list(read_tubers(view, "story"))
    for part in (str(path), "table tuber", "run 'story', tuber_id '4'", f"ledger repair {path}"):
        assert part in str(raised.value)


def test_a_row_that_is_gone_is_missed_by_whoever_reads_on(finished: Path, tmp_path: Path) -> None:
    for tuber_id in (1, 5, 12):
        path = copied(finished, tmp_path / str(tuber_id))
        db = sqlite3.connect(path, isolation_level=None)
        db.execute("DROP TRIGGER tuber_delete")
        db.execute("DELETE FROM tuber WHERE tuber_id = ?", (tuber_id,))
        db.close()
        with reading(path) as view, pytest.raises(LedgerError, match=f"lacks .*tuber_id {tuber_id},"):
            list(read_tubers(view, "story"))
        with reading(path) as view, pytest.raises(LedgerError, match=f"tuber_id {tuber_id},"):
            list(read_tubers(view, "story", since=tuber_id - 1, limit=3))


def test_there_is_no_way_to_rows_but_the_verifying_one() -> None:
    """SQL that reads is found in the view, in the repair that looks past damage, and in the step of the sums."""
    allowed = {"verified.py", "salvage.py", "steps.py"}
    found = {}
    for file in sorted((ROOT / "aggregator").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and "execute" in node.func.attr:
                text = ast.unparse(node)
                if "SELECT" in text and "sqlite_master" not in text:
                    found[file.name] = text
    assert set(found) <= allowed, found


def test_a_killed_writer_leaves_no_seal_and_a_sound_ledger(finished: Path, tmp_path: Path) -> None:
    """The seal is broken before the first write: a ledger that no one closed is judged by its rows alone."""
    path = copied(finished, tmp_path / "copy")
    ledger = Ledger(path).__enter__()
    ledger.open_run("second", line="t", cameras=["a"], version="1", started_ns=0)
    crashed = copied(path, tmp_path / "crashed")
    shutil.copy(path.with_name("ledger.db-wal"), crashed.with_name("ledger.db-wal"))
    ledger.__exit__(None, None, None)
    assert check_file(crashed) == []
    assert check_file(path) == []
    flip(path, path.stat().st_size - 1, 0)
    assert any("seal" in fault for fault in check_file(path))
