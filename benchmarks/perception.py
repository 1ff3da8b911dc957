"""The fixed suite of perception: masks, counts, misses, doubles, load and time per stage on simulated belts with truth.

    python -m benchmarks perception --out runs/perception [--scenes touching crowded] [--seeds 1301 1302] [--tubers 300]

Recordings are made once under OUT/recordings (about 100 MB each) and results kept as OUT/<case>-every<N>.json, after
all options that they depend on: what is there is not done again, so the command may be stopped and called again; with
another version or other weights it takes --fresh. Tables: OUT/perception.md, of all results in OUT with this preset,
number of tubers and --every. The recordings' masks serve as truth only.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.options import parser_of, whole_number
from benchmarks.perception_case import SUITE, Case, suite
from benchmarks.perception_line import run_line
from benchmarks.perception_table import shortfalls, tables
from benchmarks.perception_time import stage_times
from conveyor.config import parse_config
from conveyor.errors import InputError, TuberlineError
from regressor.weigh.weigher import Weigher
from segmenter.pipeline import Settings
from segmenter.setup import core_settings
from segmenter.studies.evaluate import evaluate_recording

TIMED = (("crowded", "d405-848"), ("crowded", "d405-1280"))
TIMED_TUBERS = 60


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the suite's recordings and score them."""
    options = _options(arguments)
    unknown = [scene for scene in options.scenes if scene not in SUITE]
    if unknown:
        raise InputError(f"--scenes {' '.join(unknown)}: known are {', '.join(SUITE)}")
    out: Path = options.out
    out.mkdir(parents=True, exist_ok=True)
    settings = core_settings(parse_config({}, where="of the benchmark"))
    cases = suite(tuple(options.scenes), seeds=tuple(options.seeds), tubers=options.tubers, preset=options.preset)
    for case in cases:
        _kept(_result_file(out, case, options.every), options.fresh, lambda c=case: _score(c, options, settings))
    timed = [Case(scene, options.seeds[0], TIMED_TUBERS, options.preset, camera) for scene, camera in TIMED]
    times = [
        _kept(out / f"time-{case.name}.json", options.fresh, lambda c=case: _time(c, out, settings))
        for case in timed
        if options.times
    ]
    rows = _all_kept(out, preset=options.preset, tubers=options.tubers, every=options.every)
    text = tables(rows, times)
    (out / "perception.md").write_text(text, encoding="utf-8")
    sys.stdout.write(text)
    for line in shortfalls(rows):
        sys.stdout.write(f"\nmisses its goal: {line}")
    sys.stdout.write("\n")
    if options.graph:
        for case in cases:
            _compare_graph(case, out, options.every)


def _result_file(out: Path, case: Case, every: int) -> Path:
    return out / f"{case.name}-every{every}.json"


def _kept(path: Path, fresh: bool, make: Any) -> dict[str, Any]:
    """The result at `path`, made now where it is not there."""
    if not fresh and path.is_file():
        return dict(json.loads(path.read_text(encoding="utf-8")))
    sys.stderr.write(f"{path.stem} ...\n")
    result: dict[str, Any] = make()
    path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return result


def _all_kept(out: Path, *, preset: str, tubers: int, every: int) -> list[dict[str, Any]]:
    """All results of scenes in `out` with so many tubers of a preset and that `--every`, in the suite's order."""
    rows = [dict(json.loads(path.read_text(encoding="utf-8"))) for path in out.glob(f"*-seed*-every{every}.json")]
    rows = [row for row in rows if (row["preset"], row["tubers"]) == (preset, tubers)]
    return sorted(rows, key=lambda row: (SUITE.index(row["scene"]), row["seed"], row["name"]))


def _score(case: Case, options: argparse.Namespace, settings: Settings) -> dict[str, Any]:
    recording = case.recording(options.out / "recordings")
    weigher = Weigher.load()
    line = run_line(recording, weigher)
    score = line.score(recording / "truth.json")
    as_given = run_line(recording, weigher, belt_follow_mm=0.0).score(recording / "truth.json")
    masks = evaluate_recording(recording, settings=settings, every=options.every)
    distractors = json.loads((recording / "truth.json").read_text(encoding="utf-8"))["distractors"]
    return {
        **asdict(case),
        "name": case.name,
        "score": score.as_dict(),
        "belt_as_given": as_given.as_dict(),
        "belt_off_mm": line.belt_off_mm,
        "masks": asdict(masks),
        "discarded": line.discarded,
        "distractors": distractors,
    }


def _time(case: Case, out: Path, settings: Settings) -> dict[str, Any]:
    recording = case.recording(out / "recordings")
    return {"name": f"{case.scene}, {case.camera}", "times": stage_times(recording, settings)}


def _compare_graph(case: Case, out: Path, every: int) -> None:
    """The same recording through `tuberline replay`: real processes over Zenoh must count the same."""
    from aggregator.scoring.score import score_run
    from tuberline.replayer import replay_recording

    recording = case.recording(out / "recordings")
    run = out / "graph" / case.name
    if not (run / "summary.json").is_file():
        replay_recording(recording, out=run, ignore_masks=True)
    graph = score_run(run, truth=recording / "truth.json").as_dict()
    here = json.loads(_result_file(out, case, every).read_text(encoding="utf-8"))["score"]
    differs = [name for name in ("count", "missed", "double_counted", "false") if graph[name] != here[name]]
    if differs:
        raise TuberlineError(f"{case.name}: the graph and this process differ in {', '.join(differs)}; see {run}")
    sys.stdout.write(
        f"{case.name}: the graph of real processes counts the same {graph['count']}, weighs {graph['weight_g']:.0f} g; "
        f"this process {here['weight_g']:.0f} g\n"
    )


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = parser_of("perception", __doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/perception"), help="recordings, results and tables")
    parser.add_argument("--scenes", nargs="+", default=list(SUITE), metavar="SCENE", help="default: all eight")
    parser.add_argument("--seeds", nargs="+", type=whole_number(0), default=[1301], metavar="N")
    parser.add_argument("--tubers", type=whole_number(1), default=300)
    parser.add_argument("--preset", choices=("easy", "field"), default="field")
    parser.add_argument("--every", type=whole_number(1), default=3, help="score the masks of every n-th frame")
    parser.add_argument("--times", action="store_true", help="also time the stages at both resolutions")
    parser.add_argument("--graph", action="store_true", help="also run each recording through `tuberline replay`")
    parser.add_argument("--fresh", action="store_true", help="score again what was scored before")
    return parser.parse_args(arguments)
