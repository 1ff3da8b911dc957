"""Long work shows a bar with the time that remains in a terminal, and nothing in a log."""

from __future__ import annotations

import io
import re
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from aggregator.ledger.reader import read_tubers, reading
from aggregator.ledger.verified import TOLD_EVERY, told_rows
from conveyor.messages import Counters
from tests.written_run import write_run
from tuberline.cli import progress
from tuberline.cli.live import line_table, losses, nodes_tables
from tuberline.cli.markdown import print_markdown
from tuberline.cli.replay_table import replay_table

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("terminal", [False, True])
def test_a_terminal_sees_a_bar_and_a_log_sees_nothing(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.StringIO()
    monkeypatch.setattr(
        progress, "console", lambda: Console(file=out, force_terminal=terminal, width=80, color_system=None)
    )
    with progress.frames_bar() as on_frame:
        for done in range(1, 5):
            on_frame(done, 4)
    said = out.getvalue()
    assert ("frames" in said and "100%" in said) is terminal
    assert terminal or said == ""


def test_a_log_is_a_log(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.frames_bar() as on_frame:
        on_frame(1, 2)
    sys.stderr.flush()
    assert capsys.readouterr().err == ""


def test_a_new_part_of_the_work_has_a_remaining_time_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.StringIO()
    monkeypatch.setattr(
        progress, "console", lambda: Console(file=out, force_terminal=True, width=80, color_system=None)
    )
    with progress.work_bar("reading views") as on_work:
        for words, count in (("preparing train", 4), ("weighing", 2)):
            for done in range(1, count + 1):
                on_work(words, done, count)
    said = out.getvalue()
    assert "weighing" in said
    assert "100%" in said


def test_a_reading_of_a_ledger_says_how_far_it_is(tmp_path: Path) -> None:
    count = 2 * TOLD_EVERY + 1
    crossed_ns = 10**18 + 10**8 * np.arange(count)
    write_run(tmp_path, run="r", crossed_ns=crossed_ns, weight_g=np.full(count, 150.0))
    told: list[tuple[str, int, int | None]] = []
    with reading(tmp_path / "ledger.db") as view:
        list(read_tubers(view, "r"))
        assert told == [], "no one asked"
        with told_rows(lambda *said: told.append(said)):
            list(read_tubers(view, "r"))
    assert [said for said in told if said[0] == "ledger: tuber"] == [
        ("ledger: tuber", done, count) for done in (0, TOLD_EVERY, 2 * TOLD_EVERY)
    ]


def test_every_long_command_shows_the_bar_of_the_house() -> None:
    """Bars of rich's own write their last state into a log."""
    own = re.compile(r"\bProgress\(|console\.status\(|rich\.status")
    found = [path.name for path in (ROOT / "tuberline").rglob("*.py") if own.search(path.read_text(encoding="utf-8"))]
    assert found == ["progress.py"]


def test_a_replay_says_how_long_its_frames_still_take() -> None:
    out = io.StringIO()
    with replay_table(80, on=Console(file=out, force_terminal=True, width=80, color_system=None)) as show:
        for done in (20, 40, 60):
            name, values = "segmenter/front", {"frames_processed": done}
            show(None, {name: Counters("segmenter", "front", "r", 1, "h", "1", 1.0, values, {})}, {name})
            time.sleep(0.1)
    assert "75%" in out.getvalue()
    assert re.search(r"75% 0:00:0\d", out.getvalue()), out.getvalue()


def test_a_replay_says_that_it_looks_first() -> None:
    out = io.StringIO()
    with replay_table(80, on=Console(file=out, force_terminal=True, width=80, color_system=None)) as show:
        for values in ({"frames_looked_first": 30}, {"frames_looked_first": 40, "frames_processed": 20}):
            show(None, {"segmenter/front": Counters("segmenter", "front", "r", 1, "h", "1", 1.0, values, {})}, set())
            time.sleep(0.3)
    assert "looked first at 30 frames" in out.getvalue()
    assert "looked first" not in out.getvalue().rsplit("25%", 1)[0].rsplit("\n", 1)[1]


def test_what_a_resumed_replay_found_done_is_no_pace() -> None:
    """Two cameras of 1000 frames each; half of it was done when they are first heard, one after the other."""
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=80, color_system=None)
    with replay_table(2000, on=console) as show:
        for front, rear in ((500, None), (500, 500), (502, 500), (502, 501), (504, 502)):
            counts = {"front": front} | ({} if rear is None else {"rear": rear})
            nodes = {
                f"segmenter/{name}": Counters("segmenter", name, "r", 1, "h", "1", 1.0, {"frames_processed": n}, {})
                for name, n in counts.items()
            }
            show(None, nodes, set(nodes))
            time.sleep(0.05)
    left = re.findall(r"50% (\d):(\d\d):(\d\d)", out.getvalue())
    assert left, out.getvalue()
    hours, minutes, seconds = map(int, left[-1])
    assert 3600 * hours + 60 * minutes + seconds >= 15, "994 frames at 40 a second at most; it said 2 s"


METHODS = ("PointRAFT with visible volume (as weighed)", "linear on box L, W, h (the paper's baseline)")


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_a_table_of_a_report_cuts_no_word(width: int) -> None:
    columns = ("method", "MAE g", "RMSE g", "bias g", "R2", "MAE g per tuber", "bias of a 300-tuber load %")
    figures = ("10.79", "15.73", "-0.40", "0.979", "9.71", "-0.25 (-1.04 to +0.51)")
    rows = [columns, ("---",) * len(columns), *((name, *figures) for name in METHODS)]
    report = "\n".join(["# Title", "", *("| " + " | ".join(row) + " |" for row in rows), "", "Weights `a@b`."])
    out = io.StringIO()
    print_markdown(report, Console(file=out, width=width, color_system=None))
    lines = out.getvalue().splitlines()
    words = " ".join(lines).split()
    assert max(map(len, lines)) <= width
    assert not any("…" in line for line in lines)
    for name in METHODS:
        assert all(word in words for word in name.split()), name
    assert words.count("15.73") == len(METHODS)


def test_no_name_of_a_status_is_folded_in_eighty_columns() -> None:
    lost = {"frames_dropped_camera_changed": 12345, "views_lost_weigh_deadline": 3, "views_refused_few_points": 7}
    values = {"frames_processed": 1234567, "views_sent": 1234567, "tracks_counted": 123456, **lost}
    name = "segmenter/harvester-2-left"
    told = Counters("segmenter", "harvester-2-left", "r", 1, "h", "1", 12345.0, values, {})
    out = io.StringIO()
    Console(file=out, width=80, color_system=None).print(*nodes_tables({name: told}, alive={name}))
    lines = out.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    for words in (name, "processed 1234567", *(f"{key} {count}" for key, count in lost.items())):
        assert any(words in line for line in lines), words


def test_what_a_camera_takes_off_outlines_is_no_loss() -> None:
    levels = {"outline_lost_px": -0.79, "belt_drift_mm": 0.2}
    told = Counters("segmenter", "left", "r", 1, "h", "1", 5.0, {"frames_gaps": 2}, levels)
    assert losses(told) == {"frames_gaps": 2.0}
    assert losses(replace(told, gauges={**levels, "outline_lost_px": 0.8})) == {"frames_gaps": 2.0}


def test_a_node_of_the_config_that_is_gone_has_a_row() -> None:
    """A camera that had given up was in no row of `tuberline status`: its last report goes with its process."""
    there, silent = "segmenter/left", "aggregator/aggregator"
    told = Counters("segmenter", "left", "r", 1, "h", "1", 5.0, {"frames_processed": 3}, {})
    expected = {"camera/left", there, silent}

    def rows(alive: set[str]) -> str:
        out = io.StringIO()
        nodes = {there: told} if alive else {}
        Console(file=out, width=100, color_system=None).print(line_table(None, nodes, alive=alive, expected=expected))
        return out.getvalue()

    lines = rows({there, silent}).splitlines()
    state_of = {words[0]: words[1] for words in map(str.split, lines) if len(words) > 1}
    assert state_of["camera/left"] == "gone"
    assert state_of[there] == "ok"
    assert state_of["aggregator"] == "silent"
    assert any("not there; `tuberline doctor` and its log say why" in line for line in lines)
    assert "camera/left" not in rows(set()), "of a line that does not run one sentence is enough"
