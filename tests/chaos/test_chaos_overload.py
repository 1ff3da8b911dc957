"""Overload that lasts: five times too many frames for half a minute, and regressors that get a fraction of the time.

Views per tuber go first, then frames; what no regressor can weigh is given up early, by volume, flagged and counted.
"""

from __future__ import annotations

import json
import signal
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from benchmarks.soak import loop
from tests.belts import tuberline
from tests.chaos.harness import DisturbedLine, live_run

pytestmark = [pytest.mark.graph, pytest.mark.slow, pytest.mark.timeout(420)]
WEIGH_DEADLINE_S = 30.0
BELT_S = 120.0
SPEED = 5.0


@pytest.fixture(scope="module")
def long_recording(live_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two minutes of belt: the live recording laid end to end."""
    return loop(live_recording, tmp_path_factory.mktemp("long") / "belt", for_s=BELT_S)


def sheets(summary: dict[str, Any]) -> tuple[dict[str, int], dict[str, int], dict[str, int]]:
    """The only camera's sheets of frames, views and tracks."""
    (sheet,) = summary["cameras"].values()
    return sheet["frames"], sheet["views"], sheet["tracks"]


def test_flooded_regressors_cost_views_first_and_no_tuber_waits_in_vain(long_recording: Path, tmp_path: Path) -> None:
    seen: dict[str, list[float]] = {"age_ms": [0.0], "waiting": [0.0]}

    def throttle(line: DisturbedLine) -> None:
        """The only regressor gets a fifth of the time, for as long as the camera runs."""
        until = time.monotonic() + BELT_S / SPEED
        while time.monotonic() < until and not line.supervisor.finished("aggregator"):
            line.signal("regressor-r1", signal.SIGSTOP)
            line.go_on(0.2)
            line.signal("regressor-r1", signal.SIGCONT)
            line.go_on(0.05)
            seen["age_ms"].append(line.gauge("frame_age_max_ms"))
            seen["waiting"].append(line.gauge("tracks_waiting"))

    out = tmp_path / "run"
    settings = {"segmenter": {"weigh_deadline_s": WEIGH_DEADLINE_S, "spare_wait_s": 2.0}}
    summary = live_run(long_recording, out, throttle, speed=SPEED, regressors=1, settings=settings, timeout_s=240)
    assert summary["balanced"], summary["differences"]
    frames, views, tracks = sheets(summary)
    assert max(seen["age_ms"]) <= 500.0
    assert views["lost_shed"] > 0
    assert views.get("lost_weigh_deadline", 0) == 0, "tubers waited in vain instead of being given up early"
    drops = {name: n for name, n in frames.items() if name.startswith("dropped_")}
    assert sum(drops.values()) + frames["processed"] + frames["gaps"] == frames["published"]
    rows = [
        json.loads(row)
        for row in tuberline("ledger", "export", out / "ledger.db", "--canonical").stdout.split("\n")
        if row
    ]
    tubers = [row for row in rows if "tuber" in row]
    methods = Counter(row["method"] for row in tubers)
    by_volume = [row for row in tubers if "no_view_weighed" in row["flags"]]
    assert methods["volume"] == len(by_volume) == summary["methods"].get("volume", 0)
    assert (len(by_volume) > 0) == (views.get("lost_overload", 0) > 0)
    assert views["weighed"] >= tracks["counted"] - len(by_volume)
    sys.stdout.write(f"views {views}, frames {frames}, methods {methods}, oldest {max(seen['age_ms']):.0f} ms\n")
