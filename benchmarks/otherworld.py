"""Counts and weighs recordings of a world that Tuberline was never tuned on: other shapes, cameras, noise, belts.

    python -m benchmarks otherworld --docs docs/otherworld.md

Each recording (`otherworld_scenes`) is written to OUT/recordings and kept; each goes through the code of the whole line
in one process, as `tuberline replay` runs it (`perception_line`), or with --graph through `tuberline replay` itself.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from aggregator.ledger.reader import ledger_file, read_tubers, reading, the_run
from aggregator.scoring.score import Score, score_run
from benchmarks.command import tuberline
from benchmarks.figures_in_docs import put_table
from benchmarks.options import page_with, parser_of, whole_number
from benchmarks.otherworld_scenes import Scene, write
from benchmarks.otherworld_table import SCENES
from benchmarks.otherworld_views import views_table
from conveyor.errors import InputError
from conveyor.messages import Tuber

MATCH_MM = 25.0
SINGLE_PERCENT = 8.0
LOAD_PERCENT = 2.5


def main(arguments: Sequence[str]) -> None:
    """Write, count, weigh and print a Markdown table."""
    parser = parser_of("otherworld", __doc__)
    parser.add_argument(
        "--out", type=Path, default=Path("runs/otherworld"), help="recordings and results are kept here"
    )
    parser.add_argument("--scenes", nargs="+", metavar="NAME", help="default: all")
    parser.add_argument("--tubers", type=whole_number(1), help="of each recording; default: as planned")
    parser.add_argument(
        "--shift", type=int, default=0, help="added to the planned seeds: other recordings of each kind"
    )
    parser.add_argument("--graph", action="store_true", help="by `tuberline replay`: processes over Zenoh")
    parser.add_argument("--fast", action="store_true", help="by `tuberline replay --fast`")
    parser.add_argument(
        "--views", type=whole_number(0), default=0, help="also so many single tubers before each kind of camera"
    )
    parser.add_argument(
        "--docs", type=page_with("otherworld"), nargs="+", default=[], help="pages between whose marks the table is put"
    )
    given = parser.parse_args(arguments)
    rows = []
    for scene in chosen(SCENES, given.scenes, given.tubers, given.shift):
        how = "fast" if given.fast else "graph" if given.graph else "line"
        rows.append(kept(given.out, scene, how))
        print(row(rows[-1]), flush=True)
    text = table(rows)
    print(text)
    singles = views_table(given.views) if given.views else ""
    print(singles)
    for page in given.docs:
        put_table(page, "otherworld", text)
        if singles:
            put_table(page, "otherworld_views", singles)


def chosen(scenes: Sequence[Scene], names: Sequence[str] | None, tubers: int | None, shift: int) -> list[Scene]:
    """All of a table's scenes, or those named, or smaller or other ones of their kind."""
    known = {scene.name: scene for scene in scenes}
    for name in names or ():
        if name not in known:
            raise InputError(f"scene '{name}' is unknown; known: {', '.join(known)}")
    return [
        replace(scene, seed=scene.seed + shift, tubers=tubers or scene.tubers)
        for name, scene in known.items()
        if not names or name in names
    ]


def kept(out: Path, scene: Scene, how: str) -> dict[str, Any]:
    """What a recording led to; run only where it is not kept yet."""
    label = f"{scene.name}-{scene.seed}-{scene.tubers}"
    file = out / f"{label}-{how}.json"
    if not file.exists():
        recording = out / "recordings" / label
        if not (recording / "truth.json").exists():
            shutil.rmtree(recording, ignore_errors=True)  # an earlier call was ended while it wrote
            write(scene, recording)
        score, tubers, more = _by_line(recording) if how == "line" else _by_replay(recording, out / "runs", how)
        truth = json.loads((recording / "truth.json").read_text(encoding="utf-8"))
        found = {"scene": scene.name, "seed": scene.seed, **score.as_dict(), **more, **_singles(score, tubers, truth)}
        file.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return dict(json.loads(file.read_text(encoding="utf-8")))


def _by_line(recording: Path) -> tuple[Score, Sequence[Tuber], dict[str, Any]]:
    from benchmarks.perception_line import run_line
    from regressor.weigh.weigher import Weigher

    result = run_line(recording, Weigher.load(None))
    return (
        result.score(recording / "truth.json"),
        result.tubers,
        {
            "discarded": result.discarded,
            "belt_off_mm": result.belt_off_mm,
            "outline_lost_px": result.outline_lost_px,
            "parts": dict(result.totals.parts_percent),
        },
    )


def _by_replay(recording: Path, runs: Path, how: str) -> tuple[Score, Sequence[Tuber], dict[str, Any]]:
    out = runs / f"{recording.name}-{how}"
    tuberline("replay", recording, "--out", out, "--regressors", "1", *(["--fast"] if how == "fast" else []))
    ledger = ledger_file(out)
    with reading(ledger) as view:
        tubers = list(read_tubers(view, the_run(view, ledger, None).run))
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    return score_run(out, truth=recording / "truth.json"), tubers, {"parts": summary.get("parts_percent", {})}


def _singles(score: Score, tubers: Sequence[Tuber], truth: dict[str, Any]) -> dict[str, Any]:
    """Error in percent of each true tuber that was counted at its place, and what was counted that is a clod or stone.

    Args:
        score: where it was aligned, places along the belt are fitted to the truth as it says.
    """
    rows: list[list[float]] = []
    if not tubers:
        return {"single_errors": rows, "foreign": len(truth["foreign"]), "foreign_counted": 0}
    told = np.array([(tuber.place_x_m, tuber.place_y_m) for tuber in tubers])
    if score.aligned:
        told[:, 0] = told[:, 0] * score.scale + score.offset_mm / 1000
    for true in truth["tubers"]:
        apart = np.hypot(*(told - [true["place_x_m"], true["place_y_m"]]).T)
        nearest = tubers[int(apart.argmin())]
        if apart.min() <= MATCH_MM / 1000:
            grams = true["weight_g"]
            rows.append([grams, 100 * (nearest.weight_g / grams - 1), float(nearest.low_g <= grams <= nearest.high_g)])
    false = set(score.false_ids)
    others = np.array([(one["place_x_m"], one["place_y_m"]) for one in truth["foreign"]]).reshape(-1, 2)
    taken = 0
    for tuber, place in zip(tubers, told, strict=True):
        taken += bool(tuber.tuber_id in false and len(others) and np.hypot(*(others - place).T).min() < MATCH_MM / 1000)
    return {"single_errors": rows, "foreign": len(truth["foreign"]), "foreign_counted": taken}


HEAD = (
    "| recording | true | missed | twice | false | load off | 90 % interval | holds | belt seen "
    "| outlines, px | singles: MAE | within 8 % | intervals hold |\n"
    "| --- | ---: | ---: | ---: | ---: | ---: | ---: | --- | ---: | ---: | ---: | ---: | ---: |"
)


def row(found: dict[str, Any]) -> str:
    """One line of the table."""
    true_g = found["true_weight_g"]
    low, high = (100 * (found[key] / true_g - 1) for key in ("estimated_low_g", "estimated_high_g"))
    singles = np.array(found["single_errors"]).reshape(-1, 3)
    errors = np.abs(singles[:, 1])
    cells = [
        found["scene"],
        found["true_count"],
        found["missed"],
        found["double_counted"],
        found["false"],
        f"{found['estimated_error_percent']:+.1f} %",
        f"{low:+.0f} to {high:+.0f} %",
        "yes" if low <= 0 <= high else "**no**",
        "-" if found["coverage"] is None else f"{100 * found['coverage']:.0f} %",
        " ".join(f"{-lost_px:+.1f}" for lost_px in found.get("outline_lost_px", {}).values()) or "-",
        f"{errors.mean():.1f} %" if len(errors) else "-",
        f"{100 * (errors <= SINGLE_PERCENT).mean():.0f} %" if len(errors) else "-",
        f"{100 * singles[:, 2].mean():.0f} %" if len(errors) else "-",
    ]
    return "| " + " | ".join(map(str, cells)) + " |"


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: a line for each recording and one for all."""
    errors = np.array([found["estimated_error_percent"] for found in rows])
    held = sum(found["estimated_low_g"] <= found["true_weight_g"] <= found["estimated_high_g"] for found in rows)
    singles = np.array([one for found in rows for one in found["single_errors"]]).reshape(-1, 3)
    true, missed, twice, false = (sum(f[k] for f in rows) for k in ("true_count", "missed", "double_counted", "false"))
    near = int((np.abs(errors) <= LOAD_PERCENT).sum())
    off = np.abs(singles[:, 1])
    cells = [
        f"all | {true} | {missed} | {twice} | {false}",
        f"mean {errors.mean():+.1f}, sd {errors.std():.1f} %, {near} of {len(rows)} within {LOAD_PERCENT:g} %",
        f"| {held} of {len(rows)}",
        f"| | {off.mean():.1f} %",
        f"{100 * (off <= SINGLE_PERCENT).mean():.0f} %",
        f"{100 * singles[:, 2].mean():.0f} %",
    ]
    total = f"| {' | '.join(cells)} |"
    others, taken = (sum(f[k] for f in rows) for k in ("foreign", "foreign_counted"))
    note = f"\n\nOf {others} clods and stones {taken} were counted as tubers; they are among the false."
    return "\n".join([HEAD, *map(row, rows), total]) + note
