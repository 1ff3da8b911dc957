"""Loads in the database say what they say elsewhere: no weight where no belt was seen, and what is no load."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from aggregator.ledger.writer import Ledger
from conveyor.errors import InputError
from tests.aggregator.loaded_story import told_with_loads
from tests.sync.postgres import Postgres
from tests.written_run import write_run
from tuberline.cli.ledger_totals import totals
from tuberline.sync.push import connect, push
from tuberline.sync.schema import SCHEMA

psycopg = pytest.importorskip("psycopg")
KG = "raw_kg, weight_kg, low_kg, high_kg"


def write(path: Path) -> Path:
    """Two loads, belt without one, and a run whose camera never said a word."""
    with Ledger(path) as ledger:
        told_with_loads(ledger)
        ledger.open_run("dark", line="story", cameras=("left",), version="1", started_ns=1)
    return path


def test_what_was_not_seen_has_no_weight_and_what_passed_without_a_load_is_none(
    empty: Postgres, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It weighed 0 kg, and a load more than were started was counted."""
    path = write(tmp_path / "ledger.db")
    with connect(empty.url) as connection:
        push(connection, path)
        rows = connection.execute(f"SELECT load, is_load, tubers, {KG} FROM {SCHEMA}.load").fetchall()
        views = connection.execute(f"SELECT sum(loads), sum(weight_kg) FROM {SCHEMA}.totals_by_line").fetchall()
    there = {row[0]: row[1:] for row in rows}
    assert there["dark"] == (True, 0, None, None, None, None)
    assert [there[load][0] for load in ("1 A", "2 B", "story, without a load")] == [True, True, False]
    assert None not in there["story, without a load"]
    assert views == [(3, pytest.approx(sum(row[3] for row in there.values() if row[3] is not None)))]
    totals(path, json=True)
    told = {total["label"]: total for total in json.loads(capsys.readouterr().out)["totals"]}
    assert told["dark"]["raw_g"] is None
    grams = {name: value for name, value in told["dark"]["sums"].items() if name.endswith("_g")}
    assert grams == dict.fromkeys(("as_weighed_g", "weight_g", "seen_g", "estimated_g", "low_g", "high_g"))
    assert told["1 A"]["sums"]["estimated_g"] == pytest.approx(1000 * there["1 A"][3])
    assert told["all"]["raw_g"] > 0


def test_a_database_of_before_is_brought_up_to_date(empty: Postgres, tmp_path: Path) -> None:
    """Its loads had no column `is_load` and had to have a weight."""
    path = write(tmp_path / "ledger.db")
    with connect(empty.url) as connection:
        for by in ("field", "variety", "day", "line"):
            connection.execute(f"DROP VIEW {SCHEMA}.totals_by_{by}")
        connection.execute(f"ALTER TABLE {SCHEMA}.load DROP COLUMN is_load")
        connection.execute(f"ALTER TABLE {SCHEMA}.load ALTER COLUMN raw_kg SET NOT NULL")
    for new in (True, False):
        done = subprocess.run(
            [sys.executable, "-m", "tuberline", "sync", empty.url, path], capture_output=True, text=True, check=True
        )
        assert (": 0 new tubers" not in done.stdout) == new
    with connect(empty.url) as connection:
        assert connection.execute(f"SELECT sum(loads) FROM {SCHEMA}.totals_by_line").fetchall() == [(3,)]


def test_two_lines_of_one_name_are_told_what_helps_and_lose_no_tuber(empty: Postgres, tmp_path: Path) -> None:
    """They were told to delete the run in the database, which is the other line's."""
    crossed_ns = 1_789_400_000_000_000_000 + np.arange(20) * 10**9
    one, other, fewer = (tmp_path / name for name in ("one", "other", "fewer"))
    for folder, grams, count in ((one, 100.0, 20), (other, 150.0, 20), (fewer, 150.0, 9)):
        write_run(folder, run="monday", line="north", crossed_ns=crossed_ns[:count], weight_g=np.full(count, grams))
    with connect(empty.url) as connection:
        push(connection, one)
        there = connection.execute(f"SELECT tuber, weight_g FROM {SCHEMA}.tuber ORDER BY tuber").fetchall()
        for folder in (other, fewer):
            with pytest.raises(InputError) as refusal:
                push(connection, folder)
            told = str(refusal.value)
            assert "another line that is called north, too" in told
            assert "give one of them a name of its own" in told
            assert "sync this run into a database of its own" in told
            assert "DELETE" not in told.partition("Where that ledger counts no more, ")[0]
        assert connection.execute(f"SELECT tuber, weight_g FROM {SCHEMA}.tuber ORDER BY tuber").fetchall() == there
