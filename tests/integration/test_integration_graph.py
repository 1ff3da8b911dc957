"""The whole graph on recorded frames: real router, cameras, segmenters, two regressors, aggregator, each a process."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from segmenter.log_store import LogStore
from tests.belts import here, replay, tuberline

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]


def summary_of(run_dir: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((run_dir / "summary.json").read_text())
    return loaded


def score_of(run_dir: Path, recording: Path) -> dict[str, Any]:
    scored: dict[str, Any] = json.loads(here("score", run_dir, "--truth", recording / "truth.json", "--json").stdout)
    return scored


def export_of(run_dir: Path) -> str:
    return here("ledger", "export", run_dir / "ledger.db", "--canonical").stdout


def tubers_of(run_dir: Path) -> list[dict[str, str]]:
    with (run_dir / "tubers.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_every_tuber_is_counted_once(run_dir: Path, recording: Path) -> None:
    score = score_of(run_dir, recording)
    assert (score["missed"], score["double_counted"], score["false"]) == (0, 0, 0)
    assert score["count"] == score["true_count"] > 10


def test_weights_are_near_the_truth(run_dir: Path, recording: Path) -> None:
    score = score_of(run_dir, recording)
    assert score["mae_g"] < 20.0
    assert score["rmse_g"] < 30.0
    assert abs(score["weight_error_percent"]) < 8.0


def test_nothing_is_lost_silently_at_any_hop(run_dir: Path, recording: Path) -> None:
    summary = summary_of(run_dir)
    assert summary["balanced"] is True
    tables = sorted(recording.glob("*/frames.csv"))
    frames_on_disk = {table.parent.name: len(table.read_text().splitlines()) - 1 for table in tables}
    assert len(frames_on_disk) == 2
    for camera, frames in frames_on_disk.items():
        sheet = summary["cameras"][camera]
        assert sheet["frames"]["published"] == frames
        assert sheet["frames"]["received"] == sheet["frames"]["processed"] == frames
        assert sheet["frames"]["gaps"] == 0
        views = sheet["views"]
        assert views["sent"] == views["weighed"] + sum(n for key, n in views.items() if key.startswith("lost_"))
        assert views["sent"] > 0
    assert tuberline("audit", run_dir).returncode == 0


def test_the_table_of_tubers_is_the_ledger(run_dir: Path) -> None:
    rows = tubers_of(run_dir)
    totals = summary_of(run_dir)["totals"]
    assert len(rows) == totals["count"]
    assert sum(float(row["weight_g"]) for row in rows) == pytest.approx(totals["weight_g"], rel=1e-4)


def test_same_recording_same_ledger(run_dir: Path, recording: Path, tmp_path: Path) -> None:
    """Three regressors instead of one, twice real time instead of as fast as it goes; two at real time: tests/chaos."""
    replay(recording, tmp_path / "again", "--regressors", "3", "--speed", "2")
    assert export_of(tmp_path / "again") == export_of(run_dir)


def test_a_fast_replay_finds_the_same_tubers_by_fewer_views(run_dir: Path, recording: Path, tmp_path: Path) -> None:
    replay(recording, tmp_path / "fast", "--fast", "--regressors", "1")
    exact, fast = tubers_of(run_dir), tubers_of(tmp_path / "fast")
    places = ("id", "place_x_m", "place_y_m", "cameras", "crossed_ns")
    assert [[row[key] for key in places] for row in fast] == [[row[key] for key in places] for row in exact]
    assert all("centroids_16" in row["flags"] for row in fast)
    assert not any("centroids" in row["flags"] or "bfloat16" in row["flags"] for row in exact)
    assert all(1 <= int(row["views"]) <= len(row["cameras"].split()) for row in fast)
    assert sum(int(row["views"]) for row in exact) > 2.5 * sum(int(row["views"]) for row in fast)
    total_g, exact_g = (sum(float(row["weight_g"]) for row in rows) for rows in (fast, exact))
    assert total_g == pytest.approx(exact_g, rel=0.03)


def test_a_second_run_into_the_same_folder_is_refused(run_dir: Path, recording: Path) -> None:
    before = (run_dir / "summary.json").read_bytes()
    done = tuberline("replay", recording, "--out", run_dir, check=False)
    assert done.returncode == 2
    assert "already holds a run" in done.stderr
    assert (run_dir / "summary.json").read_bytes() == before


def test_every_segmenter_has_its_last_acknowledgement(run_dir: Path) -> None:
    """The aggregator leaves once they said so, and not before: nothing is left to be sent to a next one."""
    logs = sorted((run_dir / "state").glob("*.db"))
    assert len(logs) == 2
    for path in logs:
        _, camera, run = path.stem.split(".", 2)
        with LogStore(path, camera=camera, run=run) as store:
            stored = store.load()
        assert stored.committed == stored.newest > 0
