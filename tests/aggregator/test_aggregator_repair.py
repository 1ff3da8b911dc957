"""A repair brings back all that any row still tells, names all that is gone, and nothing is counted twice after it."""

from __future__ import annotations

import csv
import json
import shutil
import sqlite3
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from aggregator.ledger.check import check_file
from aggregator.ledger.export import full_lines
from aggregator.ledger.load_list import told_loads
from aggregator.ledger.reader import read_runs, reading
from aggregator.ledger.repair import repair
from aggregator.ledger.salvage import one_bit_off
from aggregator.ledger.schema import row
from aggregator.ledger.totals_by import totals_by
from aggregator.ledger.writer import Ledger
from conveyor.errors import NoLedgerError
from conveyor.messages import Tuber
from tests.aggregator.belt_story import Story, tell
from tests.aggregator.finished_ledger import copied, flip
from tests.aggregator.virtual_line import Aggregator
from tuberline.cli.commands import build_app
from tuberline.cli.export import export
from tuberline.export.report.gather import day_facts
from tuberline.export.report.wrong import what_went_wrong

PAGE = 4096
FLIPS, MANY, TORN = 24, 1000, 16


def contents(path: Path) -> object:
    """All that a ledger tells."""
    with reading(path) as view:
        runs = read_runs(view)
        return runs, [list(full_lines(view, run)) for run in runs], told_loads(view, limit=9)


def test_any_flipped_bit_of_a_ledger_at_rest_is_put_back(
    finished: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    put_back_each(finished, tmp_path, rng, FLIPS)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_thousand_flipped_bits_are_each_put_back(finished: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    put_back_each(finished, tmp_path, rng, MANY)


def put_back_each(finished: Path, tmp_path: Path, rng: np.random.Generator, n: int) -> None:
    expected, size = contents(finished), finished.stat().st_size
    for i in range(n):
        path = copied(finished, tmp_path / str(i))
        at, bit = int(rng.integers(size)), int(rng.integers(8))
        flip(path, at, bit)
        report = repair(path)
        assert report.lost == [], f"bit {bit} of byte {at}"
        assert check_file(path) == [], f"bit {bit} of byte {at}"
        assert contents(path) == expected, f"bit {bit} of byte {at}"
        shutil.rmtree(path.parent)


def test_a_page_that_is_gone_is_made_again_or_named(finished: Path, tmp_path: Path) -> None:
    """Each in turn, that of the schema too: what differs is never without a word."""
    expected, told = contents(finished), Counter[bool]()
    for number in range(finished.stat().st_size // PAGE):
        path = copied(finished, tmp_path / str(number))
        without_pages(path, [number])
        report = repair(path)
        assert check_file(path) == [], number
        assert report.lost or contents(path) == expected, number
        told[bool(report.lost)] += 1
        shutil.rmtree(path.parent)
    assert min(told.values()) > 10, "both must happen"


def without_pages(path: Path, numbers: list[int]) -> None:
    data = bytearray(path.read_bytes())
    for number in numbers:
        data[PAGE * number : PAGE * (number + 1)] = bytes(PAGE)
    path.write_bytes(data)


def told_story() -> Story:
    return tell(11, n=30, cameras=2, length_m=3.0)


@pytest.fixture(scope="module")
def cut_off(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, int], list[str]]:
    """(a ledger as a power cut leaves it, what it acknowledged, how the run ends): most of it is in its log."""
    live, folder = tmp_path_factory.mktemp("live"), tmp_path_factory.mktemp("image")
    with Ledger(live / "ledger.db") as ledger:
        it = Aggregator(ledger, told_story())
        acknowledged: dict[str, int] = {}
        for n in it.commits():
            if n == 8:
                ledger._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            if n == 20:
                for name in ("ledger.db", "ledger.db-wal", "ledger.ack"):
                    shutil.copy(live / name, folder / name)
                acknowledged = dict(it.acknowledged)
        return folder, acknowledged, it.canonical()


def gone_on_with(path: Path, acknowledged: dict[str, int]) -> tuple[list[Tuber], list[str]]:
    """The tubers and the canonical lines of the run after the cameras sent all that was not acknowledged."""
    with Ledger(path) as ledger:
        it = Aggregator(ledger, told_story())
        it.acknowledged = dict(acknowledged)
        it.deliver_the_rest()
        it.commit()
        return it.tubers(), it.canonical()


@pytest.mark.parametrize("name", ["ledger.db", "ledger.db-wal"])
def test_a_flip_in_file_or_log_costs_nothing_of_what_was_acknowledged(
    name: str,
    cut_off: tuple[Path, dict[str, int], list[str]],
    tmp_path: Path,
    rng: np.random.Generator,
) -> None:
    """SQLite drops all of a log behind a flipped bit."""
    folder, acknowledged, end = cut_off
    for i in range(FLIPS // 2):
        shutil.copytree(folder, tmp_path / str(i))
        path = tmp_path / str(i) / "ledger.db"
        victim = path.with_name(name)
        flip(victim, at := int(rng.integers(victim.stat().st_size)), int(rng.integers(8)))
        assert repair(path).lost == [], at
        assert check_file(path) == [], at
        assert gone_on_with(path, acknowledged)[1] == end, at
        shutil.rmtree(path.parent)


def test_a_run_that_goes_on_after_a_repair_counts_nothing_twice(
    cut_off: tuple[Path, dict[str, int], list[str]], tmp_path: Path, rng: np.random.Generator
) -> None:
    """Tubers whose observation was lost were counted once more."""
    folder, acknowledged, end = cut_off
    named = 0
    for i in range(TORN):
        shutil.copytree(folder, tmp_path / str(i))
        path = tmp_path / str(i) / "ledger.db"
        victim = path.with_name(("ledger.db", "ledger.db-wal")[i % 2])
        without_pages(victim, [int(rng.integers(victim.stat().st_size // PAGE)) for _ in range(4)])
        report = repair(path)
        assert check_file(path) == []
        tubers, lines = gone_on_with(path, acknowledged)
        assert check_file(path) == []
        tracks = Counter(track for tuber in tubers for track in tuber.tracks)
        assert set(tracks.values()) <= {1}
        assert len(tubers) <= len(told_story().seen())
        assert lines == end or report.lost
        named += bool(report.lost)
        shutil.rmtree(path.parent)
    assert 0 < named < TORN


def two_runs(path: Path) -> None:
    """Two finished runs in one ledger."""
    with Ledger(path) as ledger:
        for run in ("one", "one-more"):
            it = Aggregator(ledger, tell(11, n=12, cameras=2).in_run(run))
            it.commit_one_by_one()
            ledger.finish(run, json.dumps({"run": run}))


def without_rows(path: Path, sql: str) -> None:
    """Rows are gone, and what they said is nowhere in the file."""
    db = sqlite3.connect(path, isolation_level=None)
    db.execute("PRAGMA secure_delete = ON")
    for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
        db.execute(f"DROP TRIGGER {name}")
    db.executescript(sql)
    db.close()


@pytest.mark.parametrize(
    ("sql", "lost"),
    [
        ("DELETE FROM run WHERE run = 'one'", "the row of run one itself"),
        ("DELETE FROM total WHERE run = 'one'", "its coverage is told by their marks alone"),
        ("DELETE FROM summary WHERE run = 'one'", "the summary of run one"),
        ("DELETE FROM entry WHERE run = 'one' AND n > 4", "of the entries of cam1 in run one: 5, 6"),
        ("DELETE FROM tuber WHERE run = 'one' AND tuber_id > 3", ""),
        ("DELETE FROM observation WHERE run = 'one'", ""),
        ("DELETE FROM coverage WHERE run = 'one'", ""),
        ("DELETE FROM batch WHERE run = 'one'", ""),
    ],
)
def test_rows_that_are_gone_are_made_again_or_named_and_the_other_run_is_as_it_was(
    sql: str, lost: str, tmp_path: Path
) -> None:
    path = tmp_path / "ledger.db"
    two_runs(path)
    with reading(path) as view:
        before = {run.run: list(full_lines(view, run)) for run in read_runs(view)}
    without_rows(path, sql)
    report = repair(path)
    assert check_file(path) == []
    with reading(path) as view:
        after = {run.run: list(full_lines(view, run)) for run in read_runs(view)}
        finished = {run.run: run.finished for run in read_runs(view)}
    assert after["one-more"] == before["one-more"]
    assert finished["one-more"]
    assert any(lost in text for text in report.lost) if lost else report.lost == []
    assert lost or after == before


def test_the_command_names_what_is_lost_and_says_so_by_its_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "ledger.db"
    two_runs(path)
    without_rows(path, "DELETE FROM entry WHERE run = 'one' AND camera = 'cam0' AND n = 3")
    with pytest.raises(SystemExit) as ended:
        build_app()(("ledger", "repair", str(tmp_path)))
    assert ended.value.code == 1
    assert "LOST: 1 of the entries of cam0 in run one: 3\n" in capsys.readouterr().out


def test_totals_name_a_run_that_was_cut_off_or_repaired_with_losses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A load of which one tuber of 34 was left was told with all of its belt seen, and without a word."""
    path = tmp_path / "ledger.db"
    two_runs(path)
    assert {total.remarks for total in totals_by([path], "load")[0]} == {()}
    without_rows(path, "DELETE FROM entry WHERE run = 'one' AND n > 4; DELETE FROM tuber WHERE run = 'one'")
    assert repair(path).lost
    with Ledger(path) as ledger:
        cut = tell(11, n=12, cameras=2).in_run("cut")
        for _ in zip(range(9), Aggregator(ledger, cut).commits(), strict=False):
            pass
        told = {total.label: total.remarks for total in totals_by([path], "load")[0]}
        assert told["cut"] == (), "it is being written"
    lossy = "Run one was repaired with losses: its ledger holds less than it did. Tubers, weights and belt seen are "
    lossy += "of what is left."
    cut_off = "Run cut was cut off: its aggregator ended without a word. This is what is committed."
    told = {total.label: total.remarks for total in totals_by([path], "load")[0]}
    assert told == {"one": (lossy,), "one-more": (), "cut": (cut_off,), "all": (lossy, cut_off)}
    assert {lossy, cut_off} < set(what_went_wrong(day_facts([path])))
    build_app()(("ledger", "totals", str(path)), result_action="return_value")
    assert f"{lossy} {cut_off}" in " ".join(capsys.readouterr().out.split())
    build_app()(("ledger", "totals", str(path), "--json"), result_action="return_value")
    assert json.loads(capsys.readouterr().out)["totals"][-1]["remarks"] == [lossy, cut_off]
    assert repair(path).lost == [], "a second repair finds nothing"
    assert set(totals_by([path], "load")[0][-1].remarks) == {lossy, cut_off}, "what the first one lost is still gone"
    assert check_file(path) == []


def test_loads_name_a_run_that_was_repaired_with_losses(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = copied(finished, tmp_path / "run")
    without_rows(path, "DELETE FROM tuber WHERE tuber_id > 3; DELETE FROM entry WHERE n > 9")
    assert repair(path).lost
    build_app()(("load", "show", "--ledger", str(path)), result_action="return_value")
    assert capsys.readouterr().out.count(" was repaired with losses: ") == 1
    export([path], format="csv", what="loads", out=tmp_path / "loads.csv")
    with (tmp_path / "loads.csv").open() as file:
        assert all(" was repaired with losses: " in row["remarks"] for row in csv.DictReader(file))


def test_a_file_without_any_row_is_refused_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "ledger.db"
    path.write_bytes(bytes(5 * PAGE))
    with pytest.raises(NoLedgerError, match="is no ledger: it does not begin as SQLite files do"):
        repair(path)
    assert path.read_bytes() == bytes(5 * PAGE)


def test_one_bit_is_put_back_and_two_are_not() -> None:
    whole = row(("käse", 1.25, 7, b"xyz", None, 0.1))
    assert one_bit_off((whole[0], 1.75, *whole[2:])) == whole
    assert one_bit_off((*whole[:-1], whole[-1] ^ 8)) == whole
    damaged = "käse".encode().replace(b"\xc3", b"\x83").decode("utf-8", "surrogateescape")
    assert one_bit_off((damaged, *whole[1:])) == whole
    assert one_bit_off(("kase", *whole[1:])) is None
    assert one_bit_off((whole[0], 1.75, 7, b"xyy", *whole[4:])) is None
