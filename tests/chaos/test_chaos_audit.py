"""The balance sheet can fail: a ledger whose numbers were falsified does not pass the audit."""

from __future__ import annotations

import json
import shutil
import sqlite3
from pathlib import Path

import pytest

from aggregator.ledger.schema import ENTRY, checksum
from conveyor.messages import TrackEntry
from tests.belts import here, tuberline

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]


@pytest.fixture
def copy(run_dir: Path, tmp_path: Path) -> Path:
    """A copy of the undisturbed run."""
    return Path(shutil.copytree(run_dir, tmp_path / "run"))


def falsify(run: Path, *statements: str) -> None:
    """Change rows behind the ledger's back: its triggers are taken away first."""
    with sqlite3.connect(run / "ledger.db") as db:
        for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
            db.execute(f"DROP TRIGGER {name}")
        for statement in statements:
            assert db.execute(statement).rowcount > 0, f"changed nothing: {statement}"
    db.close()


def test_an_untouched_run_passes(copy: Path) -> None:
    assert here("audit", copy).returncode == 0


def test_a_tuber_taken_out_is_missed(copy: Path) -> None:
    falsify(copy, "DELETE FROM tuber WHERE tuber_id = 5")
    done = tuberline("audit", copy, check=False)
    assert done.returncode == 1, done.stderr
    assert "tubers" in done.stdout + done.stderr


def test_a_track_nobody_accounts_for_is_missed(copy: Path) -> None:
    falsify(copy, "DELETE FROM observation WHERE role = 'counted' AND n = (SELECT min(n) FROM observation)")
    assert here("audit", copy).returncode == 1


def test_frames_that_vanish_from_a_sheet_are_missed(copy: Path) -> None:
    with sqlite3.connect(copy / "ledger.db") as db:
        row, *columns, _crc = db.execute(
            f"SELECT rowid, {', '.join(ENTRY.names)}, crc FROM entry WHERE kind = 'mark' ORDER BY camera, n DESC"
        ).fetchone()
    db.close()
    entry = TrackEntry.decode(columns[-1])
    assert entry.mark is not None
    entry.mark.frames["processed"] -= 3
    columns[-1] = entry.encode()  # with a checksum that fits: a fault of a program, not of the disk
    falsify(
        copy,
        f"UPDATE entry SET payload = x'{columns[-1].hex()}', crc = {checksum(columns)} WHERE rowid = {row}",
    )
    done = here("audit", copy, "--json")
    assert done.returncode == 1
    laws = [law for laws in json.loads(done.stdout)["equations"].values() for law in laws if law["difference"]]
    assert [abs(law["difference"]) for law in laws] == [3]
