"""Unequal inference machines share unequally, and a laptop comes and goes: views by host in each stretch of a run.

    python -m benchmarks site_unequal          # as root, about two minutes

The site of `benchmarks.site` with three inference hosts of 8, 4 and 2 % of a core. After a while a laptop with 8 %
joins, weighs along, and is switched off in an orderly way; no one's configuration names it.
"""

from __future__ import annotations

import signal
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from benchmarks.command import audited, scored
from benchmarks.options import parser_of, whole_number
from benchmarks.site import CAMERA_HOSTS, make_recording
from benchmarks.site_line import CAMERAS, SiteLine
from benchmarks.site_net import Network
from conveyor.errors import TuberlineError

SHARES = {"inference-1": 0.08, "inference-2": 0.04, "inference-3": 0.02}
LAPTOP, LAPTOP_SHARE = "laptop", 0.08
JOINS_AT, LEAVES_AFTER = 60, 150
"""Weights: seen before the laptop starts, and seen between its first one and its end."""


def main(arguments: list[str]) -> None:
    """Run the site once and print the table."""
    parser = parser_of("site_unequal", __doc__)
    parser.add_argument("--tubers", type=whole_number(1), default=96, help="on the simulated belt")
    parser.add_argument("--seed", type=whole_number(0), default=3, help="of the simulated belt")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="tuberline-site-") as folder:
        recording = make_recording(Path(folder), tubers=options.tubers, seed=options.seed)
        seen = run(recording, Path(folder) / "run")
        score = scored(Path(folder) / "run", recording / "truth.json")
        audit = audited(Path(folder) / "run")
    sys.stdout.write(table(seen["passed"], joined_s=seen["joined_s"], left_s=seen["left_s"]))
    sys.stdout.write(
        f"\n{score['count']} tubers, {score['missed']} missed, {score['double_counted']} double; "
        f"balanced: {audit['balanced']}\n"
    )


def run(recording: Path, out: Path) -> dict[str, Any]:
    """What the probe saw, with the moments of the laptop's first and last weight as 'joined_s' and 'left_s'."""
    with Network() as network:
        for host in ("edge", *CAMERA_HOSTS, *SHARES, LAPTOP):
            network.add(host)
        with SiteLine(network, recording, out) as line:
            line.start_probe()
            line.start_node("edge", "aggregator")
            for host, camera in zip(CAMERA_HOSTS, CAMERAS, strict=True):
                line.start_node(host, "segmenter", "--camera", camera)
            for host, share in SHARES.items():
                start_limited(line, host, share)
            line.wait_alive([f"segmenter/{camera}" for camera in CAMERAS] + ["aggregator/aggregator"], timeout_s=240)
            for host, camera in zip(CAMERA_HOSTS, CAMERAS, strict=True):
                line.start_node(host, "camera", "--camera", camera)
            line.wait(lambda: line.weights >= JOINS_AT, what=f"{JOINS_AT} weights", timeout_s=240)
            start_limited(line, LAPTOP, LAPTOP_SHARE)
            leaves_at = line.weights + LEAVES_AFTER
            line.wait(lambda: line.weights >= leaves_at or line.finished, what=f"{leaves_at} weights", timeout_s=240)
            line.signal(f"regressor/{LAPTOP}", signal.SIGTERM)
            line.wait_finished(timeout_s=300)
            seen = line.finish_probe()
    if not any(entry["regressor"] == LAPTOP for entry in seen["passed"]):
        raise TuberlineError("everything was weighed before the laptop was there: take more --tubers")
    theirs_s = [entry["at_s"] for entry in seen["passed"] if entry["regressor"] == LAPTOP]
    return {**seen, "joined_s": theirs_s[0], "left_s": theirs_s[-1]}


def start_limited(line: SiteLine, host: str, share: float) -> None:
    """A regressor on `host`, held to its share of a core once it is warm."""
    line.start_node(host, "regressor", "--name", host)
    line.wait_alive([f"regressor/{host}"], timeout_s=240)
    line.limit(f"regressor/{host}", share=share)


def table(passed: list[dict[str, Any]], *, joined_s: float, left_s: float) -> str:
    """Views by host before, with and after the laptop, and the part of them that its share of the CPU would give."""
    shares = {**SHARES, LAPTOP: LAPTOP_SHARE}
    stretches = {
        "before the laptop": [entry for entry in passed if entry["at_s"] < joined_s],
        "with it": [entry for entry in passed if joined_s <= entry["at_s"] <= left_s],
        "after it": [entry for entry in passed if entry["at_s"] > left_s],
    }
    head = "| inference host | share of a core | " + " | ".join(f"{name}: views, of all, by CPU" for name in stretches)
    rows = [head + " |", "| --- " * (2 + len(stretches)) + "|"]
    for host, share in shares.items():
        cells = []
        for name, entries in stretches.items():
            count = Counter(entry["regressor"] for entry in entries)[host]
            there = sum(shares.values()) if name == "with it" else sum(SHARES.values())
            due = 0.0 if host == LAPTOP and name != "with it" else share / there
            cells.append(f"{count}, {100 * count / max(len(entries), 1):.0f} %, {100 * due:.0f} %")
        rows.append(f"| {host} | {100 * share:g} % | {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"
