"""kill -9 at every write point of the ledger: what was acknowledged is there, once, and the run goes on to its end."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from aggregator.ledger.at_rest import order_at_rest
from aggregator.ledger.check import check_file
from aggregator.ledger.verified import reading
from aggregator.ledger.writer import Ledger
from conveyor.errors import UnmadeError
from conveyor.messages import LoadOrder
from tests.aggregator.belt_story import tell
from tests.aggregator.virtual_line import Aggregator, fresh_run, undisturbed

ROOT = Path(__file__).resolve().parents[2]
SEED = 3


def run_jobs(jobs: list[tuple[str, int, int, float]]) -> list[int]:
    """Exit statuses of the killed children, as waitpid gives them."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.aggregator.ledger_child"],
        input=json.dumps(jobs),
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return [int(line) for line in done.stdout.split()]


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    with Ledger(tmp_path_factory.mktemp("calm") / "ledger.db") as ledger:
        return undisturbed(ledger, tell(SEED, n=10, cameras=2)).canonical()


def faults_or_none(ledger: Path) -> list[str] | None:
    """What is wrong with a ledger; None where it is empty, which the check must say like every reader."""
    try:
        return check_file(ledger)
    except UnmadeError:
        with pytest.raises(UnmadeError, match=r"is empty\. Either its aggregator was stopped before it had made it"):
            reading(ledger).__enter__()
        return None


def survives(folder: Path, calm: list[str]) -> int:
    """Reopen what a killed process left, check it against what it acknowledged, and finish the story."""
    said = folder / "acknowledged"
    acknowledged = dict(line.split() for line in said.read_text().splitlines()) if said.exists() else {}
    if (folder / "ledger.db").exists():
        assert faults_or_none(folder / "ledger.db") in ([], None)
    with Ledger(folder / "ledger.db") as ledger:
        it = Aggregator(ledger, tell(SEED, n=10, cameras=2))
        for camera, n in acknowledged.items():
            assert it.core.applied()[camera] >= int(n)
        it.acknowledged = {**dict.fromkeys(it.story.names, 0), **{c: int(n) for c, n in acknowledged.items()}}
        it.deliver_the_rest()
        assert it.core.finished
        assert it.canonical() == calm
    return sum(int(n) for n in acknowledged.values())


def test_killed_at_every_write_point(tmp_path: Path, calm: list[str]) -> None:
    points = [*range(22), *range(22, 150, 7)]
    jobs = [(str(tmp_path / f"at{point}"), SEED, point, 0.0) for point in points]
    for folder, *_ in jobs:
        Path(folder).mkdir()
    statuses = run_jobs(jobs)
    assert set(statuses) == {9}
    acknowledged = [survives(Path(folder), calm) for folder, *_ in jobs]
    assert acknowledged[0] == 0
    assert sorted(acknowledged) == acknowledged
    assert acknowledged[-1] > 10


def test_killed_at_any_moment(tmp_path: Path, calm: list[str], rng: np.random.Generator) -> None:
    jobs = [(str(tmp_path / f"t{i}"), SEED, 10**9, float(rng.uniform(0.01, 0.12))) for i in range(12)]
    for folder, *_ in jobs:
        Path(folder).mkdir()
    statuses = run_jobs(jobs)
    assert set(statuses) <= {0, 9}
    for folder, *_ in jobs:
        survives(Path(folder), calm)


def test_killed_while_the_file_was_made_it_can_be_opened(tmp_path: Path, calm: list[str]) -> None:
    """What is left is a file with a journal and no receipt: every later start refused it as read-only."""
    making = (
        "import os, sqlite3, sys\n"
        "db = sqlite3.connect(sys.argv[1], isolation_level=None)\n"
        "db.execute('PRAGMA cache_size = 1')\n"
        "db.execute('BEGIN')\n"
        "db.execute('CREATE TABLE t (x)')\n"
        "db.executemany('INSERT INTO t VALUES (?)', [(bytes(4000),)] * 50)\n"
        "os._exit(9)\n"
    )
    ledger = tmp_path / "ledger.db"
    subprocess.run([sys.executable, "-c", making, str(ledger)], check=False, timeout=60)
    assert ledger.stat().st_size > 0
    assert (tmp_path / "ledger.db-journal").stat().st_size > 0
    assert not (tmp_path / "ledger.ack").exists()
    survives(tmp_path, calm)


@pytest.mark.parametrize(("stopped_at", "made"), [("before create", False), ("before run", True)])
def test_a_ledger_whose_making_was_stopped_is_told_as_empty_by_every_reader(
    tmp_path: Path, stopped_at: str, made: bool
) -> None:
    """`ledger check` said that it is no ledger of Tuberline and that `ledger repair` saves what is intact."""
    code = (
        "import os, sys\nfrom pathlib import Path\nfrom aggregator.ledger.writer import Ledger\n"
        f"with Ledger(Path(sys.argv[1]), step=lambda name: name == '{stopped_at}' and os._exit(9)) as ledger:\n"
        "    ledger.open_run('r1', line='x', cameras=['a'], version='1', started_ns=1)\n"
    )
    ledger = tmp_path / "ledger.db"
    subprocess.run([sys.executable, "-c", code, str(ledger)], cwd=ROOT, check=False, timeout=60)
    assert faults_or_none(ledger) == ([] if made else None)


def test_a_file_copied_without_its_write_ahead_log_is_told_from_a_ledger_that_was_lost(tmp_path: Path) -> None:
    told = tell(SEED, n=10, cameras=2)
    with Ledger(tmp_path / "ledger.db") as ledger:
        Aggregator(ledger, told).deliver_the_rest()
        for name in ("ledger.db", "ledger.ack"):
            (tmp_path / f"copy-{name}").write_bytes((tmp_path / name).read_bytes())
    copy = tmp_path / "copy-ledger.db"
    assert any("batches of it were acknowledged: the file was lost" in fault for fault in check_file(copy))
    (tmp_path / "copy-ledger.ack").unlink()
    with pytest.raises(UnmadeError, match=r"copy copy-ledger\.db-wal and copy-ledger\.ack with it"):
        check_file(copy)


def test_a_second_writer_is_refused(tmp_path: Path) -> None:
    from conveyor.errors import LedgerError

    with Ledger(tmp_path / "ledger.db"), pytest.raises(LedgerError, match="being written by another process"):
        Ledger(tmp_path / "ledger.db").__enter__()
    with Ledger(tmp_path / "ledger.db"), pytest.raises(LedgerError, match="give the order to that line, without --led"):
        order_at_rest(tmp_path / "ledger.db", LoadOrder("n", "note", note="wet"))


def test_the_story_is_the_same_in_every_process() -> None:
    """The children rebuild the story from its seed: it must not depend on the process."""
    assert tell(SEED).in_run(fresh_run("x")).logs.keys() == tell(SEED).logs.keys()
    assert tell(SEED) == tell(SEED)
