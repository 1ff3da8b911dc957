"""Three first days, each from a clean clone with the commands of docs/walks.md as they are printed there (slow)."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.walks.foxglove_picture import weights_in
from tests.walks.walk import LIMIT_S, Walk, section

pytestmark = [pytest.mark.slow, pytest.mark.timeout(5 * LIMIT_S)]


@pytest.fixture
def walk(tmp_path: Path) -> Walk:
    """A clean clone."""
    return Walk(tmp_path)


def test_a_researcher_takes_a_network_of_their_own_elsewhere(walk: Walk) -> None:
    told = {line: walk.type(line) for line in section("A researcher")}
    weighed = walk.rows("weighed.csv")
    assert len(weighed) == len(list((walk.clone / "mycrop" / "1_rgbd" / "2_pcd").rglob("*.ply"))) > 20
    assert all(float(row["low_g"]) < float(row["weight_g"]) < float(row["high_g"]) for row in weighed)
    assert "PointRAFT" in (walk.clone / "out" / "mine" / "report.md").read_text(encoding="utf-8")
    outside = told[section("A researcher")[-1]].splitlines()
    walk.type(
        "tuberline weigh mycrop/1_rgbd/2_pcd --weights runs/mine/weights.safetensors --belt-distance-m 0.460 --csv"
        " > mine.csv"
    )
    for row, line in zip(walk.rows("mine.csv"), outside, strict=False):
        expected = [float(row[name]) for name in ("weight_g", "low_g", "high_g")]
        found = [float(number) for number in re.findall(r"-?[\d.]+(?= g| to)", line)]
        assert found == pytest.approx(expected, abs=0.06), (row["path"], line)
    assert len(outside) == len(weighed) + 1


def test_an_integrator_comes_to_a_line_that_is_checked_and_installed(walk: Walk) -> None:
    for line in section("An integrator"):
        if line.startswith("tuberline run"):
            walk.until_ended(walk.start(line))
        else:
            told = walk.type(line)
            if line.startswith("tuberline calibrate belt"):
                assert "camera 'front' is good: belt_distance_m = 0.4" in told
            if line.startswith("tuberline score"):
                assert re.search(r"missed\W+0\b", told), told
    tubers = walk.rows("runs/monday/tubers.csv")
    truth = json.loads((walk.clone / "recordings" / "monday" / "truth.json").read_text(encoding="utf-8"))
    assert len(tubers) == len(truth["tubers"])
    assert list((walk.clone / "installed").rglob("tuberline-aggregator*"))


def test_an_operator_watches_in_eighty_columns(walk: Walk) -> None:
    process = None
    try:
        for line in section("An operator"):
            if line.endswith("&"):
                process = walk.start(line)
                walk.until("segmenter/front: started", process)
                continue
            if line.startswith("tuberline audit"):
                assert process is not None
                walk.until_ended(process)
            # What doctor finds of a running line depends on the machine's load: its words count here.
            told = walk.type(line, codes=(0, 1) if line.startswith("tuberline doctor") else (0,))
            if line.startswith(("tuberline status", "tuberline graph", "tuberline audit")):
                assert max(map(len, told.splitlines())) <= 80, told
            if line.startswith("tuberline status"):
                assert "kg" in told
                assert "segmenter/front" in told
            if line.startswith("tuberline doctor"):
                assert "camera front" in told
    finally:
        if process is not None and process.poll() is None:
            process.kill()
    shown = weights_in(walk.clone / "monday.mcap")
    tubers = walk.rows("runs/monday/tubers.csv")
    assert len(shown) == len(tubers)
    assert sum(shown.values()) == pytest.approx(sum(float(row["weight_g"]) for row in tubers), rel=1e-4)
    lines = [json.loads(line) for line in (walk.clone / "tubers.jsonl").read_text(encoding="utf-8").splitlines()]
    truth = json.loads((walk.clone / "recordings" / "monday" / "truth.json").read_text(encoding="utf-8"))
    assert len(lines) >= len(truth["tubers"]) > 0
