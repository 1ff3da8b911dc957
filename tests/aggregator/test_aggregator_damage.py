"""A torn log, a flipped bit, a full disk, a read-only disk: everything acknowledged is there, or a loud error."""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from aggregator.ledger.at_rest import order_at_rest
from aggregator.ledger.audit import audit_run
from aggregator.ledger.check import check_file
from aggregator.ledger.reader import reading, the_run
from aggregator.ledger.receipt import read_receipt, receipt_path
from aggregator.ledger.repair import repair
from aggregator.ledger.schema import SCHEMA_VERSION, checksum
from aggregator.ledger.totals_by import all_loads
from aggregator.ledger.writer import Ledger
from conveyor.errors import LedgerError, StorageError
from conveyor.messages import LoadOrder
from tests.aggregator.belt_story import tell
from tests.aggregator.loaded_story import told_with_loads
from tests.aggregator.virtual_line import Aggregator

FLIPS = 60


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger as a crash leaves it: half of it in the main file, half in the write-ahead log, all acknowledged."""
    live, folder = tmp_path_factory.mktemp("live"), tmp_path_factory.mktemp("image")
    with Ledger(live / "ledger.db") as ledger:
        it = Aggregator(ledger, tell(11, n=12, cameras=2))
        for n in it.commits():
            if n == 12:
                ledger._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (folder / "expected").write_text("\n".join(it.canonical()))
        for name in ("ledger.db", "ledger.db-wal", "ledger.ack"):
            shutil.copy(live / name, folder / name)
    assert (folder / "ledger.db-wal").stat().st_size > 4096
    return folder


def copied(image: Path, folder: Path) -> Path:
    shutil.copytree(image, folder)
    return folder / "ledger.db"


def contents(path: Path) -> str:
    """The canonical ledger after opening it as a writer does."""
    with Ledger(path) as ledger:
        it = Aggregator(ledger, tell(11, n=12, cameras=2))
        return "\n".join(it.canonical())


def test_the_image_itself_is_sound(image: Path, tmp_path: Path) -> None:
    path = copied(image, tmp_path / "copy")
    assert check_file(path) == []
    assert contents(path) == (image / "expected").read_text()


@pytest.mark.parametrize("name", ["ledger.db", "ledger.db-wal", "ledger.ack"])
def test_a_flipped_bit_is_harmless_or_loud(name: str, image: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    expected = (image / "expected").read_text()
    loud = 0
    for i in range(FLIPS):
        path = copied(image, tmp_path / f"{i}")
        victim = path.with_name(name)
        data = bytearray(victim.read_bytes())
        at, bit = int(rng.integers(len(data))), int(rng.integers(8))
        data[at] ^= 1 << bit
        victim.write_bytes(data)
        try:
            found = contents(path)
        except LedgerError as error:
            loud += str(path.parent) in str(error)
        else:
            assert found == expected, f"bit {bit} of byte {at} of {name} changed the ledger silently"
        shutil.rmtree(path.parent)
    assert loud > 0 or name == "ledger.ack"


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9, 0.999])
def test_a_torn_log_that_loses_acknowledged_batches_is_refused(keep: float, image: Path, tmp_path: Path) -> None:
    """SQLite itself opens such a file without a word, with fewer tubers."""
    path = copied(image, tmp_path / "copy")
    log = path.with_name("ledger.db-wal")
    os.truncate(log, int(keep * log.stat().st_size))
    with pytest.raises(LedgerError, match="acknowledged"):
        Ledger(path).__enter__()
    with sqlite3.connect(path) as db:
        assert db.execute("PRAGMA quick_check").fetchone() == ("ok",)


def test_a_torn_page_that_was_never_acknowledged_is_dropped(image: Path, tmp_path: Path) -> None:
    path = copied(image, tmp_path / "copy")
    with path.with_name("ledger.db-wal").open("ab") as log:
        log.write(os.urandom(3000))
    assert contents(path) == (image / "expected").read_text()


def test_a_lost_ledger_or_receipt_is_refused(image: Path, tmp_path: Path) -> None:
    path = copied(image, tmp_path / "a")
    path.unlink()
    path.with_name("ledger.db-wal").unlink()
    with pytest.raises(LedgerError, match="batches of it were acknowledged"):
        Ledger(path).__enter__()
    path = copied(image, tmp_path / "b")
    receipt_path(path).unlink()
    with pytest.raises(LedgerError, match="receipt"):
        Ledger(path).__enter__()


def test_a_lost_receipt_is_refused_at_every_start(image: Path, tmp_path: Path) -> None:
    """The first start that was refused left an empty receipt, and the second one went on as if all were well."""
    path = copied(image, tmp_path / "a")
    receipt_path(path).unlink()
    said = []
    for _ in range(2):
        with pytest.raises(LedgerError, match=r"receipt \(.ack\) is missing") as refused:
            Ledger(path).__enter__()
        said.append(str(refused.value))
        assert not receipt_path(path).exists()
    assert said[0] == said[1]
    receipt_path(path).touch()
    with pytest.raises(LedgerError) as refused:
        Ledger(path).__enter__()
    assert str(refused.value) == said[0], "an empty receipt vouches for nothing"
    assert "receipt (.ack) is missing" in " ".join(check_file(path))
    repair(path)
    assert check_file(path) == []
    assert contents(path) == (image / "expected").read_text()


def test_a_ledger_without_batches_needs_no_receipt(tmp_path: Path) -> None:
    """As one is left by a process that was killed before it wrote anything."""
    for name, made in (("bare.db", "PRAGMA journal_mode = WAL"), ("begun.db", "")):
        path = tmp_path / name
        if made:
            with sqlite3.connect(path) as db:
                db.execute(made)
        else:
            with Ledger(path):
                pass
            receipt_path(path).unlink()
        with Ledger(path):
            pass
        assert check_file(path) == []


def test_other_files_and_versions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    path.write_text("not a database, but long enough to have a header of one hundred bytes" * 4)
    with pytest.raises(LedgerError, match="is no ledger: it does not begin as SQLite files do"):
        Ledger(path).__enter__()
    other = tmp_path / "other.db"
    with sqlite3.connect(other) as db:
        db.execute("CREATE TABLE t (x)")
    with pytest.raises(LedgerError, match="no ledger of Tuberline"):
        Ledger(other).__enter__()
    newer = tmp_path / "newer.db"
    with Ledger(newer):
        pass
    with sqlite3.connect(newer) as db:
        db.execute(f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    with pytest.raises(LedgerError, match=f"version {SCHEMA_VERSION + 1}, this program knows version {SCHEMA_VERSION}"):
        Ledger(newer).__enter__()


def test_committed_rows_cannot_be_changed(image: Path, tmp_path: Path) -> None:
    path = copied(image, tmp_path / "copy")
    with sqlite3.connect(path) as db:
        for sql in (
            "UPDATE tuber SET weight_g = 0",
            "DELETE FROM tuber",
            "DELETE FROM entry",
            "UPDATE entry SET n = 0",
        ):
            with pytest.raises(sqlite3.IntegrityError, match="never changed"):
                db.execute(sql)


def falsified(path: Path, sql: str) -> None:
    """Change rows behind the triggers' back, as a damaged disk or a busybody would."""
    db = sqlite3.connect(path, isolation_level=None)
    for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
        db.execute(f"DROP TRIGGER {name}")
    db.execute(sql)
    db.close()


@pytest.mark.parametrize(
    ("sql", "said"),
    [
        ("UPDATE tuber SET weight_g = weight_g / 2 WHERE tuber_id = 3", "wrong checksum"),
        ("DELETE FROM tuber WHERE tuber_id = 4", "its last batch says"),
        ("DELETE FROM entry WHERE n = 5", "some are missing"),
        ("DELETE FROM batch WHERE seq = 2", "batches are there"),
        ("DELETE FROM observation WHERE tuber_id = 2", "no track was counted"),
    ],
)
def test_falsified_rows_are_found_and_repair_brings_them_back(sql: str, said: str, image: Path, tmp_path: Path) -> None:
    path = copied(image, tmp_path / "copy")
    assert contents(path)
    falsified(path, sql)
    assert any(said in fault for fault in check_file(path))
    with reading(path) as view:
        assert not audit_run(view, the_run(view, path, None)).balanced
    report = repair(path)
    assert check_file(path) == [] or "DELETE FROM observation" in sql
    assert report.kept_as is not None
    assert report.kept_as.exists()
    if "entry" in sql:
        assert any("entries of" in text for text in report.lost)
    elif "observation" not in sql:
        assert report.lost == []
        assert contents(path) == (image / "expected").read_text()


def test_repair_of_a_ledger_whose_log_was_torn_says_what_is_left(image: Path, tmp_path: Path) -> None:
    path = copied(image, tmp_path / "copy")
    os.truncate(path.with_name("ledger.db-wal"), 0)
    report = repair(path)
    assert 0 < report.saved["tuber"] < len((image / "expected").read_text().splitlines()) - 3
    assert check_file(path) == []
    with Ledger(path) as ledger:
        it = Aggregator(ledger, tell(11, n=12, cameras=2))
        it.acknowledged = dict.fromkeys(it.story.names, 0)
        it.deliver_the_rest()
        assert "\n".join(it.canonical()) == (image / "expected").read_text()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own with 480 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if os.geteuid() != 0:
        pytest.skip("a full disk needs a small file system, and mounting one needs root: NOT TESTED here")
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=480k", "tmpfs", folder], capture_output=True, check=False
    )
    if done.returncode != 0:
        pytest.skip(f"a small tmpfs cannot be mounted here ({done.stderr.decode().strip()}): full disk NOT TESTED")
    yield folder
    subprocess.run(["umount", folder], check=True)


def test_a_ledger_on_a_full_disk_is_read_and_not_called_damaged(small_disk: Path, tmp_path: Path) -> None:
    """A ticket found no room, and left an empty log: from then on nothing could be read, and `ledger check` said that
    the ledger cannot be trusted and is to be repaired, which left an empty copy of it.
    """
    made, fill = tmp_path / "made", small_disk / "fill"
    with Ledger(made / "ledger.db") as ledger:
        told_with_loads(ledger)
    path = copied(made, small_disk / "run")
    with fill.open("wb", buffering=0) as file, suppress(OSError):
        while file.write(bytes(1024)):
            pass
    with pytest.raises(StorageError, match="No space left"):
        order_at_rest(path, LoadOrder("t", "ticket", by="me", load="A", kg=1.0))
    assert check_file(path) == []
    assert [load.net_g for load in all_loads([path]).loads] == [None, None, None]
    with pytest.raises(StorageError, match=r"cannot be copied to .*No space left"):
        repair(path)
    assert not list(path.parent.glob("*.damaged*"))
    fill.unlink()
    assert order_at_rest(path, LoadOrder("t", "ticket", by="me", load="A", kg=1.0)).done
    assert [load.net_g for load in all_loads([path]).loads] == [1000.0, None, None]
    assert check_file(path) == []


def test_a_full_disk_is_an_error_and_the_run_goes_on_once_there_is_space(small_disk: Path) -> None:
    told = tell(7, n=60, cameras=2, length_m=6.0)
    path = small_disk / "ledger.db"
    with Ledger(path) as ledger:
        it = Aggregator(ledger, told)
        with pytest.raises(LedgerError, match="disk is full"):
            it.commit_one_by_one()
        acknowledged = dict(it.acknowledged)
    assert sum(acknowledged.values()) > 10
    assert check_file(path) == []
    subprocess.run(["mount", "-o", "remount,size=20m", small_disk], check=True)
    with Ledger(path) as ledger:
        it = Aggregator(ledger, told)
        assert it.core.applied() == acknowledged
        it.acknowledged = acknowledged
        it.deliver_the_rest()
        assert it.core.finished
        assert len(it.tubers()) == len(told.seen())


def test_a_read_only_disk_is_refused_with_the_mend(small_disk: Path) -> None:
    with Ledger(small_disk / "ledger.db"):
        pass
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    with pytest.raises(LedgerError, match=r"read-only|Read-only"):
        Ledger(small_disk / "ledger.db").__enter__()


def test_a_read_only_file_is_refused_with_the_mend(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write read-only files; the read-only disk is tested instead")
    with Ledger(tmp_path / "ledger.db"):
        pass
    (tmp_path / "ledger.db").chmod(0o444)
    with pytest.raises(LedgerError, match="read-only"):
        Ledger(tmp_path / "ledger.db").__enter__()


def test_the_receipt_survives_a_torn_write(tmp_path: Path) -> None:
    from aggregator.ledger.receipt import Receipt

    path = tmp_path / "ledger.ack"
    with Receipt(path) as receipt:
        for seq in (0, 0, 1, 2, 3):
            receipt.write(seq)
    assert read_receipt(path) == 3
    data = bytearray(path.read_bytes())
    data[4096 + 9] ^= 0xFF
    path.write_bytes(data)
    assert read_receipt(path) == 2
    data[9] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(LedgerError, match="damaged"):
        read_receipt(path)


def test_a_minus_zero_is_no_damage() -> None:
    """The last mark of a camera that never saw a frame lies at place -0.0: the aggregator could not read it back, and
    ended the line.
    """
    with sqlite3.connect(":memory:") as db:
        db.execute("CREATE TABLE t (x REAL NOT NULL) STRICT")
        db.execute("INSERT INTO t VALUES (-0.0)")
        (back,) = db.execute("SELECT x FROM t").fetchone()
    assert checksum((back,)) == checksum((-0.0,))
    assert checksum((1.5, -2.0, "a", None, 3)) != checksum((1.5, 2.0, "a", None, 3))
