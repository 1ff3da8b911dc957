"""A file that is no ledger is told so at once by check and repair; where nothing is saved nothing is left behind."""

from __future__ import annotations

import random
import shutil
import sqlite3
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from aggregator.ledger.check import check_file
from aggregator.ledger.likeness import may_be_ledger
from aggregator.ledger.repair import repair
from aggregator.ledger.writer import Ledger
from conveyor.errors import LedgerError, NoLedgerError, StorageError, UnmadeError
from tests.aggregator.finished_ledger import write_finished
from tuberline.cli.commands import build_app

PAGE = 4096
LARGE = 26_000_000
AT_ONCE_S = 10.0


def noise(path: Path) -> None:
    path.write_bytes(random.Random(7).randbytes(LARGE))


def recorded(path: Path) -> None:
    path.write_bytes(b"\x89MCAP0\r\n" + random.Random(8).randbytes(LARGE))


def leaves_by_their_first_bytes(path: Path) -> None:
    page = b"\x0d\0\0\x07\xd0\0\0\0" + random.Random(9).randbytes(PAGE - 8)
    path.write_bytes(page * 2000)


def of_another_program(path: Path) -> None:
    db = sqlite3.connect(path)
    db.execute("CREATE TABLE bookmark (name TEXT, at INTEGER)")
    db.executemany("INSERT INTO bookmark VALUES (?, ?)", [("x" * 60, n) for n in range(20_000)])
    db.commit()
    db.close()


NO_LEDGERS: list[tuple[Callable[[Path], None], str, str]] = [
    (noise, "does not begin as SQLite files do", "does not begin as SQLite files do"),
    (recorded, "does not begin as SQLite files do", "does not begin as SQLite files do"),
    (leaves_by_their_first_bytes, "does not begin as SQLite files do", "does not begin as SQLite files do"),
    (of_another_program, "is an SQLite file, but no ledger of Tuberline", "is an SQLite file of another program"),
]


@pytest.mark.parametrize(("make", "checked", "repaired"), NO_LEDGERS, ids=[make.__name__ for make, *_ in NO_LEDGERS])
def test_what_is_no_ledger_is_refused_at_once_and_left_alone(
    make: Callable[[Path], None], checked: str, repaired: str, tmp_path: Path
) -> None:
    """A repair looked for rows in a recording for three minutes, and left a copy and an empty receipt each time."""
    path = tmp_path / "two.mcap"
    make(path)
    was = path.read_bytes()
    began_s = time.monotonic()
    with pytest.raises(NoLedgerError, match=repaired):
        repair(path)
    with pytest.raises(NoLedgerError, match=checked) as told:
        check_file(path)
    assert time.monotonic() - began_s < AT_ONCE_S
    assert "ledger check" not in str(told.value)
    assert "repair" not in str(told.value)
    assert [file.name for file in tmp_path.iterdir()] == ["two.mcap"]
    assert path.read_bytes() == was


def test_an_empty_file_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    path.touch()
    with pytest.raises(UnmadeError, match="is empty"):
        repair(path)
    assert [file.name for file in tmp_path.iterdir()] == ["ledger.db"]


def test_a_ledger_without_a_run_is_left_as_it_was(tmp_path: Path) -> None:
    """It has the header of one, so it is looked through; nothing was saved and a copy stayed."""
    path = tmp_path / "ledger.db"
    with Ledger(path):
        pass
    path.with_suffix(".ack").unlink()
    was = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    with pytest.raises(LedgerError, match=r"no run can be read from .*; it is as it was"):
        repair(path)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == was


def test_a_repair_that_cannot_be_written_leaves_nothing(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "ledger.db"
    shutil.copy(finished, path)

    def full(*_: object) -> None:
        path.with_name("ledger.db.repaired").write_bytes(b"half")
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr("aggregator.ledger.repair._write", full)
    with pytest.raises(StorageError, match="disk is full"):
        repair(path)
    assert [file.name for file in tmp_path.iterdir()] == ["ledger.db"]
    assert path.read_bytes() == finished.read_bytes()


@pytest.mark.parametrize("gone", [[0], [0, 1, 2, 3]])
def test_a_ledger_whose_first_pages_are_gone_is_still_one(gone: list[int], finished: Path, tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    data = bytearray(finished.read_bytes())
    for number in gone:
        data[PAGE * number : PAGE * (number + 1)] = bytes(PAGE)
    path.write_bytes(data)
    assert may_be_ledger(path)
    (fault,) = check_file(path)
    assert "its header is damaged; `tuberline ledger repair` saves what is intact" in fault
    assert "ledger check" not in fault
    report = repair(path)
    assert report.saved["run"] == 1
    assert check_file(path) == []


def test_a_ledger_where_no_folder_can_be_is_refused_for_good(tmp_path: Path) -> None:
    """A line tried again for ever, as if a disk were away."""
    (tmp_path / "out").write_text("a file")
    with pytest.raises(LedgerError, match=r"aggregator\.out.*a file lies where a folder is needed") as told:
        Ledger(tmp_path / "out" / "ledger.db").__enter__()
    assert told.value.exit_code == 2


def test_a_check_does_not_advise_a_check(tmp_path: Path) -> None:
    """Of damaged pages it said: '`tuberline ledger check` lists the damage'."""
    path = tmp_path / "ledger.db"
    write_finished(path)
    size = path.stat().st_size
    for number in range(1, size // PAGE):
        data = bytearray(path.read_bytes())
        data[PAGE * number : PAGE * number + 8] = b"\xff" * 8
        other = tmp_path / "other" / "ledger.db"
        other.parent.mkdir(exist_ok=True)
        other.write_bytes(data)
        assert not [fault for fault in check_file(other) if "ledger check" in fault], number


def test_the_command_says_what_the_file_is_and_no_advice_that_does_not_help(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "two.mcap"
    recorded(path)
    for command in ("check", "repair"):
        with pytest.raises(NoLedgerError, match=r"two\.mcap is no ledger: .*; give a run's folder or its ledger\.db"):
            build_app()(("ledger", command, str(path)))
    assert capsys.readouterr() == ("", "")
