"""Six cameras at five times real time, eight regressors, 30 minutes: does a process grow, and is what was shed told?

    python -m benchmarks load [--minutes 30] [--cameras 6] [--regressors 8] [--speed 5] [--out FOLDER]

A simulated belt is laid end to end; every camera plays it and waits for no one, so that far more comes than two cores
can take. Memory, descriptors and threads of each process are sampled as in `soak`, nothing is killed. FOLDER/load.md
holds the tables, FOLDER/load.json everything.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.options import above_zero, parser_of, whole_number
from benchmarks.soak import loop, markdown, read_books, simulated, soak, told

WARM_UP_S = 600.0
"""So long 22 processes on 2 cores load, compile and fill their caches."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the line and print the tables; 1 where the books do not balance or something grows."""
    parser = parser_of("load", __doc__)
    parser.add_argument("--minutes", type=above_zero, default=30.0)
    parser.add_argument("--cameras", type=whole_number(1), default=6)
    parser.add_argument("--regressors", type=whole_number(1), default=8)
    parser.add_argument("--speed", type=above_zero, default=5.0, help="times real time")
    parser.add_argument("--warm-up-s", type=float, default=WARM_UP_S, help="age at which a process counts")
    parser.add_argument("--recording", type=Path, help="folder recording to repeat; default: a simulated one")
    parser.add_argument("--out", type=Path, help="keep ledger, logs and tables here")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        out = options.out or Path(folder) / "out"
        recording = options.recording or simulated(Path(folder) / "belt")
        looped = loop(recording, Path(folder) / "looped", for_s=options.speed * (options.minutes * 60 + 60))
        load_before = os.getloadavg()[0]
        watch = soak(
            looped,
            out,
            for_s=options.minutes * 60,
            speed=options.speed,
            copies=options.cameras,
            regressors=options.regressors,
            by_the_clock=True,
        )
        books = read_books(out)
        report = told(watch, books, minutes=options.minutes, warm_up_s=options.warm_up_s)
        report["totals"] = json.loads((out / "summary.json").read_text())["totals"]
        text = "\n".join(
            [
                f"{options.cameras} cameras at {options.speed:g} times real time, {options.regressors} regressors; "
                f"machine load {load_before:.0f} before, {os.getloadavg()[0]:.0f} at the end.",
                "",
                shed(books, report["totals"]),
                "",
                markdown(report),
            ]
        )
        (out / "load.json").write_text(json.dumps(report, indent=1) + "\n")
        (out / "load.md").write_text(text)
        sys.stdout.write(text)
    return 0 if books["balanced"] and report["verdict"] != "grows" else 1


def shed(books: dict[str, Any], totals: dict[str, Any]) -> str:
    """What every camera took and left out, as it is told in the summary."""
    rows = [
        "| camera | frames published | processed | left out | views sent | weighed | lost | tracks counted |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for camera, sheet in books["cameras"].items():
        frames, views = sheet["frames"], sheet["views"]
        left_out = _named(frames, "dropped_") + ([f"{frames['gaps']} gaps"] if frames.get("gaps") else [])
        rows.append(
            f"| {camera} | {frames.get('published', 0)} | {frames.get('processed', 0)} | {', '.join(left_out) or '-'} "
            f"| {views.get('sent', 0)} | {views.get('weighed', 0)} | {', '.join(_named(views, 'lost_')) or '-'} "
            f"| {sheet['tracks'].get('counted', 0)} |"
        )
    seen = "unknown" if totals["coverage"] is None else f"{100 * totals['coverage']:.0f} %"
    rows += ["", f"{totals['count']} tubers, belt seen {seen}."]
    return "\n".join(rows)


def _named(sheet: dict[str, int], prefix: str) -> list[str]:
    return [f"{n} {name.removeprefix(prefix)}" for name, n in sheet.items() if name.startswith(prefix) and n]
