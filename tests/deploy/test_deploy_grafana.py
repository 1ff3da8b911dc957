"""The Grafana dashboards: whole by what Grafana needs of a file, and asking for metrics that a line really serves."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import suppress
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import wait_until

FOLDER = Path(__file__).resolve().parents[2] / "deploy" / "grafana"
FILES = sorted(FOLDER.glob("*.json"))
KINDS = {"stat", "timeseries", "table", "barchart"}
"""Panels that Grafana brings along."""


def boards() -> Iterator[tuple[str, dict[str, Any]]]:
    for file in FILES:
        yield file.name, json.loads(file.read_text())


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_a_dashboard_is_whole(file: Path) -> None:
    board = json.loads(file.read_text())
    assert board.get("id") is None, "an id is given by the Grafana that loads it"
    assert re.fullmatch(r"[a-z-]{1,40}", board["uid"])
    assert board["schemaVersion"] >= 39
    assert board["title"]
    variables = {variable["name"]: variable["type"] for variable in board["templating"]["list"]}
    panels = board["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels) > 8
    for panel in panels:
        assert panel["type"] in KINDS
        assert panel["title"]
        for source in (panel["datasource"], *(target["datasource"] for target in panel["targets"])):
            assert variables[source["uid"].strip("${}")] == "datasource", "whoever loads it chooses the source"
        assert [target["refId"] for target in panel["targets"]] == ["A", "B", "C"][: len(panel["targets"])]
        assert all(target.get("rawSql") or target.get("expr") for target in panel["targets"])
        used = set(
            re.findall(r"\$\{?(\w+)", json.dumps([t.get("rawSql", "") + t.get("expr", "") for t in panel["targets"]]))
        )
        assert used - {"__timeFrom", "__timeTo"} <= variables.keys()
    for one, other in combinations([panel["gridPos"] for panel in panels], 2):
        beside = one["x"] + one["w"] <= other["x"] or other["x"] + other["w"] <= one["x"]
        above = one["y"] + one["h"] <= other["y"] or other["y"] + other["h"] <= one["y"]
        assert beside or above, (one, other)
    assert all(panel["gridPos"]["x"] + panel["gridPos"]["w"] <= 24 for panel in panels)


def test_the_two_have_different_names() -> None:
    assert {name: board["uid"] for name, board in boards()} == {
        "fleet.json": "tuberline-fleet",
        "line.json": "tuberline-line",
    }


@pytest.mark.slow
def test_every_metric_of_the_dashboard_is_served_by_a_line(tmp_path: Path, free_port: int) -> None:
    """A replay with all its nodes, scraped as Prometheus does."""
    wanted = {
        name
        for _, board in boards()
        for panel in board["panels"]
        for target in panel["targets"]
        for name in re.findall(r"tuberline_\w+(?=\{)", target.get("expr", ""))
    }
    assert len(wanted) > 15
    command, listen = [sys.executable, "-m", "tuberline"], f"127.0.0.1:{free_port}"
    scene = ["--scene", "two-cameras", "--tubers", "8", "--seed", "7701"]
    subprocess.run([*command, "simulate", "--out", tmp_path / "belt", *scene], check=True, capture_output=True)
    replay = subprocess.Popen([*command, "replay", tmp_path / "belt", "--out", tmp_path / "run", "--speed", "0.5"])
    served: set[str] = set()
    try:
        wait_until((tmp_path / "run" / "line.toml").is_file, what="the replay's config")
        config = ["--config", tmp_path / "run" / "line.toml"]
        metrics = subprocess.Popen([*command, "metrics", *config, "--listen", listen])
        try:
            while replay.poll() is None and not wanted <= served:
                with suppress(OSError):
                    text = urllib.request.urlopen(f"http://{listen}/metrics", timeout=2).read().decode()
                    served |= set(re.findall(r"^(tuberline_\w+)\{", text, re.MULTILINE))
                time.sleep(0.2)
        finally:
            metrics.terminate()
            metrics.wait(20)
    finally:
        replay.wait(120)
    assert wanted - served == set()
