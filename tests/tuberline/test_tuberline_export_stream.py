"""Exports of all tubers read them row by row: memory does not grow with them, and a read that fails leaves nothing."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from aggregator.ledger.reader import read_tubers, reading
from conveyor.errors import LedgerError
from conveyor.messages import Tuber
from tests.written_run import write_run
from tuberline.export.counted import counted
from tuberline.export.table import BATCH
from tuberline.export.write import Format, export

FEW = 300


@pytest.fixture
def run(tmp_path: Path) -> Path:
    write(tmp_path / "run", run="monday", first_ns=0)
    return tmp_path / "run"


def write(folder: Path, *, run: str, first_ns: int) -> None:
    crossed_ns = first_ns + np.arange(1, FEW + 1, dtype=np.int64) * 1_000_000_000
    write_run(folder, run=run, crossed_ns=crossed_ns, weight_g=100.0 + np.arange(FEW) % 90)


@dataclass(frozen=True)
class Many:
    """The same tubers over and over; from the one numbered `fails_at` on they cannot be read."""

    tubers: Sequence[Tuber]
    rows: int
    fails_at: int = -1

    def __iter__(self) -> Iterator[Tuber]:
        for n in range(self.rows):
            if n == self.fails_at:
                raise LedgerError("the row of table tuber with tuber_id 7 is not as it was written")
            yield self.tubers[n % len(self.tubers)]


def tubers_of(run: Path) -> list[Tuber]:
    with reading(run / "ledger.db") as view:
        return list(read_tubers(view, "monday"))


def peak_bytes(run: Path, out: Path, form: Format, tubers: Many) -> int:
    tracemalloc.start()
    try:
        assert export([run], out, form=form, what="tubers", field=None, tubers=[tubers]) == tubers.rows
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_does_not_grow_with_the_tubers(run: Path, tmp_path: Path) -> None:
    """A million tubers as CSV took 1.5 GB, for all rows were made before the first one was written."""
    tubers, out = tubers_of(run), tmp_path / "all.csv"
    peak_bytes(run, out, Format.CSV, Many(tubers, 10))  # what is imported and cached at first
    little, much = (peak_bytes(run, out, Format.CSV, Many(tubers, rows)) for rows in (BATCH, 10 * BATCH))
    assert much < little + 200_000
    assert len(out.read_text().splitlines()) == 10 * BATCH + 1


@pytest.mark.parametrize("form", [Format.CSV, Format.PARQUET, Format.XLSX])
def test_a_row_that_cannot_be_read_leaves_what_was_there(form: Format, run: Path, tmp_path: Path) -> None:
    """Rows are read while the file is written: a damaged one comes to light in its middle."""
    (folder := tmp_path / "out").mkdir()
    (old := folder / "tubers").write_text("of yesterday")
    wrong = Many(tubers_of(run), 2 * BATCH, fails_at=BATCH + 900)
    with pytest.raises(LedgerError, match="tuber_id 7 is not as it was written"):
        export([run], old, form=form, what="tubers", field=None, tubers=[wrong])
    assert [(path.name, path.read_text()) for path in folder.iterdir()] == [("tubers", "of yesterday")]


def test_rows_of_several_batches_come_whole_and_in_order(run: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    tubers = tubers_of(run)
    rows = 2 * BATCH + 11
    out = tmp_path / "all.parquet"
    assert export([run], out, form=Format.PARQUET, what="tubers", field=None, tubers=[Many(tubers, rows)]) == rows
    found = parquet.read_table(out)
    assert found["tuber"].to_pylist() == [tubers[n % FEW].tuber_id for n in range(rows)]
    assert parquet.ParquetFile(out).num_row_groups == 1


def test_each_pass_gives_the_same_tubers_while_a_line_writes_more(run: Path) -> None:
    """Places are found in a first pass, rows written in a second one."""
    with counted([run]) as (tubers,):
        first = [tuber.tuber_id for tuber in tubers]
        write(run, run="tuesday", first_ns=86_400_000_000_000)
        assert [tuber.tuber_id for tuber in tubers] == first
        assert len(first) == FEW
    with counted([run]) as (tubers,):
        assert [tuber.run for tuber in tubers] == ["monday"] * FEW + ["tuesday"] * FEW
