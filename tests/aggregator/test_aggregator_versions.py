"""Ledgers of version 0.1 (commit a7bbfcc): every reader reads them as they are, the writer brings them up to date.

`data/v0_1`: a replay of 12 simulated tubers under two cameras, finished. `data/v0_1_unfinished`: story 11 after its
ninth entries. Both were written by that commit. `data/v2_unfinished`: the same story, by e1dbf15, of version 2.
"""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
from pathlib import Path

import pytest

from aggregator.calibration.load import ticket_of
from aggregator.core.camera_log import Taken
from aggregator.ledger.audit import audit_run
from aggregator.ledger.check import check_file
from aggregator.ledger.export import canonical_lines
from aggregator.ledger.loads import last_loads
from aggregator.ledger.reader import coverage_of, read_sums, read_tubers, reading, the_run
from aggregator.ledger.repair import repair
from aggregator.ledger.schema import SCHEMA_VERSION
from aggregator.ledger.writer import Ledger
from conveyor.errors import LedgerError
from tests.aggregator.belt_story import tell
from tests.aggregator.virtual_line import Aggregator, undisturbed

DATA = Path(__file__).parent / "data"
MIGRATION_STEPS = {"v0_1_unfinished": 30, "v2_unfinished": 25}


def copied(name: str, folder: Path) -> Path:
    folder.mkdir()
    for file in ("ledger.db", "ledger.ack"):
        shutil.copy(DATA / name / file, folder / file)
    return folder / "ledger.db"


def version(path: Path) -> int:
    db = sqlite3.connect(path)
    try:
        return int(db.execute("PRAGMA user_version").fetchone()[0])
    finally:
        db.close()


def canonical(path: Path) -> list[str]:
    with reading(path) as view:
        return list(canonical_lines(view, the_run(view, path, None)))


def test_every_reader_reads_it_as_it_is(tmp_path: Path) -> None:
    path = copied("v0_1", tmp_path / "copy")
    before = path.read_bytes()
    assert canonical(path) == (DATA / "v0_1" / "canonical.jsonl").read_text().splitlines()
    assert check_file(path) == []
    with reading(path) as view:
        run = the_run(view, path, None)
        assert audit_run(view, run).balanced
        assert run.finished
        sums = read_sums(view, run.run)
        assert sums.load.count == len(list(read_tubers(view, run.run))) == 12
        assert coverage_of(run, sums).share == 1.0
        assert last_loads(view, limit=3)[0]["count"] == 12
        weight_g = sums.load.as_weighed_g
    assert ticket_of(path, run=None, ticket_g=weight_g, ticket_sd_g=5.0).coverage == 1.0
    assert path.read_bytes() == before
    assert version(path) == 1


def test_a_flipped_weight_of_it_is_found(tmp_path: Path) -> None:
    path = copied("v0_1", tmp_path / "copy")
    db = sqlite3.connect(path, isolation_level=None)
    db.execute("DROP TRIGGER tuber_update")
    db.execute("UPDATE tuber SET weight_g = weight_g * 2 WHERE tuber_id = 2")
    db.close()
    with pytest.raises(LedgerError, match="table tuber"):
        canonical(path)
    with pytest.raises(LedgerError, match="cannot be brought to version"):
        Ledger(path).__enter__()
    assert version(path) == 1
    report = repair(path)
    assert "tuber_id '2': one bit had changed" in " ".join(report.repaired)
    assert check_file(path) == []
    assert canonical(path) == (DATA / "v0_1" / "canonical.jsonl").read_text().splitlines()


def test_the_writer_brings_it_up_to_date(tmp_path: Path) -> None:
    path = copied("v0_1", tmp_path / "copy")
    with Ledger(path) as ledger:
        ledger.open_run("next", line="t", cameras=["a"], version="1", started_ns=0)
    assert version(path) == SCHEMA_VERSION
    assert check_file(path) == []
    with reading(path) as view:
        (first, _second) = last_loads(view, limit=2)[::-1] if view.version == SCHEMA_VERSION else (None, None)
        run = the_run(view, path, first["run"] if first["run"] != "next" else _second["run"])
        assert list(canonical_lines(view, run)) == (DATA / "v0_1" / "canonical.jsonl").read_text().splitlines()


def test_an_unfinished_run_of_it_is_gone_on_with(tmp_path: Path) -> None:
    with Ledger(tmp_path / "calm.db") as ledger:
        calm = undisturbed(ledger, tell(11, n=12, cameras=2)).canonical()
    path = copied("v0_1_unfinished", tmp_path / "copy")
    with Ledger(path) as ledger:
        it = Aggregator(ledger, tell(11, n=12, cameras=2))
        assert it.core.applied() == {"cam0": 9, "cam1": 9}
        assert (len(it.tubers()), it.core.pending) == (3, 5)
        again = {it.receive(camera, n) for camera in ("cam0", "cam1") for n in range(1, 10)}
        assert again == {Taken.DUPLICATE}, "a host upgraded in a load called every entry sent again a conflict"
        it.acknowledged = it.core.applied()
        it.deliver_the_rest()
        assert it.core.finished
        assert it.canonical() == calm
    assert check_file(path) == []


@pytest.mark.parametrize(("name", "at"), [(name, at) for name, steps in MIGRATION_STEPS.items() for at in range(steps)])
def test_a_migration_killed_on_the_way_is_done_by_the_next(name: str, at: int, tmp_path: Path) -> None:
    """kill -9 at each write point of the migration: it is of the old version, whole, or of the new one, whole."""
    path = copied(name, tmp_path / "copy")
    expected = canonical(path)
    child = os.fork()
    if child == 0:
        left = [at]

        def step(_name: str) -> None:
            if left[0] == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            left[0] -= 1

        Ledger(path, step=step).__enter__()
        os._exit(0)
    _, status = os.waitpid(child, 0)
    last = MIGRATION_STEPS[name] - 1
    assert status == (signal.SIGKILL if at < last else 0), "MIGRATION_STEPS is not their number plus one"
    assert check_file(path) == []
    assert canonical(path) == expected
    with Ledger(path) as ledger:
        assert ledger.view.version == SCHEMA_VERSION
    assert version(path) == SCHEMA_VERSION
    assert check_file(path) == []
    assert canonical(path) == expected
