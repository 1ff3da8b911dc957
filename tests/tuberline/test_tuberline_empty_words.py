"""An empty word on the command line, as a variable that is not set leaves it, is refused: no command takes it for a
default or for the folder that one is in.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from cyclopts import App
from cyclopts.exceptions import CycloptsError

from tests.aggregator.finished_ledger import write_finished
from tests.tuberline.test_tuberline_numbers import commands, needed
from tuberline.cli.commands import build_app

ROOT = Path(__file__).resolve().parents[2]


def with_an_empty_word(app: App) -> Iterator[tuple[str, ...]]:
    """A command line for each option and each place of each command, which is empty there and lacks nothing else."""
    for words, options in commands(app):
        placed = sorted((option for option in options if option.index is not None), key=lambda one: one.index or 0)
        for option in options:
            if "bool" in str(option.hint):
                continue
            named = [word for one in options if one.index is None and one is not option for word in needed(one)]
            if option.index is None:
                others = [word for one in placed for word in needed(one)]
                yield (*words, *others, *named, f"{option.name}=")
            else:
                before = ["1" for one in placed if (one.index or 0) < option.index]
                after = [word for one in placed if (one.index or 0) > option.index for word in needed(one)]
                yield (*words, *named, *before, "", *after)


EMPTY = list(with_an_empty_word(build_app()))


def test_all_words_are_found() -> None:
    shown = {" ".join(words) for words in EMPTY}
    assert "load ticket " in shown
    assert "info " in shown
    assert any(words[0] == "replay" and words[-1] == "--out=" for words in EMPTY)
    assert len(EMPTY) > 400


@pytest.mark.parametrize("words", EMPTY, ids=" ".join)
def test_no_command_takes_an_empty_word(words: tuple[str, ...]) -> None:
    with pytest.raises(CycloptsError, match=r'"" is (empty|no number|no whole number)'):
        build_app().parse_args(words, exit_on_error=False, print_error=False)


def tuberline(*words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tuberline", *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "COLUMNS": "200"},
        timeout=120,
    )


def test_a_replay_to_an_empty_path_writes_nothing(tmp_path: Path) -> None:
    """Ledger, logs and state of a run were written into the folder that the user was in."""
    (tmp_path / "here").mkdir()
    done = tuberline("replay", "rec", "--out", "", folder=tmp_path / "here")
    assert done.returncode == 2
    assert 'Invalid value for --out: "" is empty, and a path is needed there' in done.stderr
    assert list((tmp_path / "here").iterdir()) == []


def test_a_ticket_for_an_empty_load_is_entered_for_none(tmp_path: Path) -> None:
    """It was entered for the last load."""
    write_finished(tmp_path / "ledger.db")
    before = (tmp_path / "ledger.db").read_bytes()
    done = tuberline("load", "ticket", "", "--kg", "14", "--ledger", ".", folder=tmp_path)
    assert done.returncode == 2
    assert '"" is empty, and a word is needed there' in done.stderr
    assert (tmp_path / "ledger.db").read_bytes() == before


@pytest.mark.parametrize(
    ("kg", "taken"),
    [("-5", False), ("0", False), ("0.0009", False), ("500000", False), ("0.001", True), ("200000", True)],
)
def test_a_ticket_is_within_the_one_range_that_is_told(kg: str, taken: bool, tmp_path: Path) -> None:
    """'Allowed is 0 to 1000000 kg' was told, of which 0 was refused, and 500000 with 'up to 200000 kg'."""
    write_finished(tmp_path / "ledger.db")
    done = tuberline("load", "ticket", "1", "--kg", kg, "--ledger", ".", "--json", folder=tmp_path)
    assert done.returncode == (0 if taken else 2), done.stderr
    if taken:
        assert json.loads(done.stdout)["done"] is True
    else:
        assert f'Invalid value "{float(kg)}" for --kg. Allowed is 0.001 to 200000 kg.' in done.stderr
