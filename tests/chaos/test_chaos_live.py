"""Cameras that wait for no one: a flooded line sheds by plan, a dead segmenter's belt is missing in the open."""

from __future__ import annotations

import json
import signal
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import pytest

from tests.belts import tuberline
from tests.chaos.harness import DisturbedLine, live_run

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]
MAX_AGE_MS = 500.0


def score_of(out: Path, recording: Path) -> dict[str, Any]:
    """The run against the truth, by place."""
    scored: dict[str, Any] = json.loads(tuberline("score", out, "--truth", recording / "truth.json", "--json").stdout)
    return scored


def sheet_of(summary: dict[str, Any]) -> tuple[dict[str, int], dict[str, int], dict[str, int]]:
    """The only camera's sheets, after checking that they and the ledger balance."""
    assert summary["balanced"], summary["differences"]
    (sheet,) = summary["cameras"].values()
    frames, views, tracks = sheet["frames"], sheet["views"], sheet["tracks"]
    dropped = sum(n for name, n in frames.items() if name.startswith("dropped_"))
    assert frames["published"] == frames["processed"] + dropped + frames["gaps"]
    lost = sum(n for name, n in views.items() if name.startswith("lost_"))
    assert views["sent"] == views["weighed"] + lost
    return frames, views, tracks


EDGE_M = 0.03
"""Half a tuber's length: so much may a gap that took tubers with it be shorter or longer than they lie apart."""


def told_what_was_missed(summary: dict[str, Any], score: dict[str, Any], recording: Path) -> None:
    """The belt that is said to be unseen is where tubers are missing: no shorter than these lie apart, and no longer
    than from the counted one before them to the counted one behind.
    """
    totals = summary["totals"]
    assert score["double_counted"] == score["false"] == 0
    assert score["count"] < score["true_count"]
    assert totals["coverage"] < 1.0
    assert (1 - totals["coverage"]) * summary["belt_m"] == pytest.approx(sum(summary["unseen_m"].values()), abs=1e-6)
    # Belt that ran while the line was started, by the clock of a live camera, is in no recording.
    unseen_m = sum(summary["unseen_m"].values()) - summary["unseen_m"].get("before_first_frame", 0.0)
    least_m, most_m = missing_belt_m(recording, {str(name) for name in score["missed_ids"]})
    assert least_m <= unseen_m <= most_m
    assert totals["weight_g"] < totals["estimated_weight_g"]
    width_g, estimated_width_g = (totals[f"{kind}high_g"] - totals[f"{kind}low_g"] for kind in ("", "estimated_"))
    assert estimated_width_g / totals["estimated_weight_g"] > width_g / totals["weight_g"]


def missing_belt_m(recording: Path, missed: set[str]) -> tuple[float, float]:
    """The least and the most belt that has to be unseen where these tubers are missed."""
    tubers = json.loads((recording / "truth.json").read_text())["tubers"]
    places = sorted((tuber["place_x_m"], str(tuber["id"]) in missed) for tuber in tubers)
    ends = (places[0][0] - EDGE_M, False), (places[-1][0] + EDGE_M, False)
    # Counted and missing ones take turns, the ends are counted.
    runs = [[place_m for place_m, _ in run] for _, run in groupby([ends[0], *places, ends[1]], key=itemgetter(1))]
    least_m = most_m = 0.0
    for before, missing, after in zip(runs[:-1:2], runs[1::2], runs[2::2], strict=True):
        least_m += max(0.0, missing[-1] - missing[0] - EDGE_M)
        most_m += after[0] - before[-1] + EDGE_M
    return least_m, most_m


def oldest_until_final(line: DisturbedLine) -> float:
    """The age of the oldest frame that was processed, milliseconds, as last reported."""
    oldest_ms = [0.0]

    def finished() -> bool:
        oldest_ms.append(line.gauge("frame_age_max_ms"))
        return line.supervisor.finished("aggregator")

    line.wait(finished, what="the summary", timeout_s=150)
    return max(oldest_ms)


@pytest.mark.slow
def test_five_times_too_many_frames_are_dropped_and_every_tuber_is_weighed(
    loaded_recording: Path, tmp_path: Path
) -> None:
    """Of an evenly loaded belt, as where a share of it is held against a share of its tubers."""
    ages: list[float] = []
    summary = live_run(
        loaded_recording, tmp_path / "run", lambda line: ages.append(oldest_until_final(line)), speed=5.0
    )
    frames, views, tracks = sheet_of(summary)
    assert frames["dropped_overwritten"] > 0
    assert frames["processed"] < frames["published"]
    assert 0.0 < max(ages) <= MAX_AGE_MS
    assert views["weighed"] >= tracks["counted"] > 0
    score = score_of(tmp_path / "run", loaded_recording)
    assert score["double_counted"] == 0
    assert score["count"] / score["true_count"] >= summary["totals"]["coverage"] - 0.1


@pytest.mark.slow
def test_a_regressor_that_cannot_keep_up_costs_views_and_no_tuber(live_recording: Path, tmp_path: Path) -> None:
    def throttle(line: DisturbedLine) -> None:
        """It gets a fifth of the time."""
        while not line.supervisor.finished("aggregator"):
            line.signal("regressor-r1", signal.SIGSTOP)
            line.go_on(0.2)
            line.signal("regressor-r1", signal.SIGCONT)
            line.go_on(0.05)

    settings = {"segmenter": {"max_pending_views": 8}}
    summary = live_run(live_recording, tmp_path / "run", throttle, regressors=1, settings=settings)
    frames, views, tracks = sheet_of(summary)
    assert views["lost_shed"] > 0
    assert views["weighed"] >= tracks["counted"] > 0
    assert frames["processed"] > 0.6 * frames["published"]
    rows = tuberline("ledger", "export", tmp_path / "run" / "ledger.db", "--canonical").stdout
    assert '"volume"' not in rows, "a tuber was logged without a view weighed"
    assert score_of(tmp_path / "run", live_recording)["double_counted"] == 0


def test_belt_that_passed_a_dead_segmenter_is_told(loaded_recording: Path, tmp_path: Path) -> None:
    def kill(line: DisturbedLine) -> None:
        line.wait_count("tracks_counted", 4)
        line.kill("segmenter-front")

    # At 0.4 the segmenter is back, on a fast machine, before any belt has left the view.
    summary = live_run(loaded_recording, tmp_path / "run", kill, speed=0.7, regressors=1)
    frames, _, tracks = sheet_of(summary)
    assert summary["restarts"]["segmenter-front"] == 1
    assert frames["gaps"] > 0
    assert tracks["opened"] >= tracks["counted"] > 0
    told_what_was_missed(summary, score_of(tmp_path / "run", loaded_recording), loaded_recording)


@pytest.mark.slow
def test_a_live_camera_whose_unit_is_restarted_goes_on_and_the_gap_is_told(
    loaded_recording: Path, tmp_path: Path
) -> None:
    """It said that it had ended: its segmenter closed the run and took no frame of the next process."""
    seen: list[int] = []

    def restart(line: DisturbedLine) -> None:
        line.wait_count("tracks_counted", 4)
        (spec,) = (spec for spec in line.watched[-1].specs if spec.name == "camera-front")
        line.restart(spec, after_s=5.0)
        seen.append(line.count("frames_processed"))

    summary = live_run(loaded_recording, tmp_path / "run", restart, speed=0.3, by_the_clock=True)
    frames, _, _ = sheet_of(summary)
    assert frames["processed"] > seen[0]
    assert frames["gaps"] > 0
    told_what_was_missed(summary, score_of(tmp_path / "run", loaded_recording), loaded_recording)


@pytest.mark.slow
def test_what_grew_old_while_the_segmenter_stood_still_is_not_processed(live_recording: Path, tmp_path: Path) -> None:
    ages: list[float] = []

    def freeze(line: DisturbedLine) -> None:
        line.wait_count("frames_processed", 8)
        line.freeze("segmenter-front", 1.5)
        ages.append(oldest_until_final(line))

    summary = live_run(live_recording, tmp_path / "run", freeze)
    frames, _, _ = sheet_of(summary)
    assert frames.get("dropped_too_old", 0) + frames.get("dropped_overwritten", 0) + frames["gaps"] > 0
    assert max(ages) <= MAX_AGE_MS
    score = score_of(tmp_path / "run", live_recording)
    assert score["double_counted"] == 0
    # What passed in so short a time may have been seen before it and after it.
    assert summary["totals"]["coverage"] == pytest.approx(score["count"] / score["true_count"], abs=0.12)
