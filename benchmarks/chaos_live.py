"""Live lines with random faults: is the truth in their intervals, and does their coverage say what was missed?

    python -m benchmarks chaos_live --runs 100 --seed S [--out FOLDER] [--jobs 2] [--only N ...]

Real processes under the product's supervisor: router, cameras that play a simulated belt by the clock, segmenters, two
regressors, aggregator. In each run one or two processes are killed or stopped for 3, 12 or 40 s, at the start, on the
way, near the end, two at once. FOLDER/runs.jsonl holds a line for each finished run, FOLDER/chaos-live.md the table; a
second call goes on where the first one stopped. Belts and what an undisturbed run weighs of them are kept in FOLDER.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from aggregator.scoring.score import score_run
from benchmarks.chaos_live_belt import make_belt, what_passed
from benchmarks.chaos_live_faults import BELTS, Case, drawn_cases
from benchmarks.chaos_live_line import OVER_S, Belt, live_line
from benchmarks.chaos_live_table import covered, inside, markdown, told, whole
from benchmarks.options import parser_of, whole_number
from tuberline.replayer import replay_recording

BELT_SEED = 131
ENOUGH_INSIDE = 0.88


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is left to run and print the table; 1 where a bar is missed."""
    parser = parser_of("chaos_live", __doc__)
    parser.add_argument("--runs", type=whole_number(1), default=100)
    parser.add_argument("--seed", type=whole_number(0), default=1)
    parser.add_argument("--belt-seed", type=whole_number(0), default=BELT_SEED)
    parser.add_argument("--out", type=Path, help="keep runs, logs, ledgers and tables here")
    parser.add_argument("--jobs", type=whole_number(1), default=1, help="lines at the same time")
    parser.add_argument("--only", type=whole_number(0), nargs="*", help="run these numbers of the plan")
    options = parser.parse_args(arguments)
    cases = drawn_cases(options.seed, options.runs, over_s=OVER_S)
    if options.only and (unknown := sorted(set(options.only) - {case.number for case in cases})):
        parser.error(f"argument --only: {unknown[0]} is no number of the plan; give some from 1 to {options.runs}")
    with tempfile.TemporaryDirectory() as folder:
        out = options.out or Path(folder)
        belts = {kind: ready_belt(kind, out / "belts", seed=options.belt_seed) for kind in dict.fromkeys(BELTS)}
        if options.only:
            cases = [case for case in cases if case.number in options.only]
        kept = out / f"seed-{options.seed}-belt-{options.belt_seed}"
        runs = run_all(cases, belts, kept, jobs=options.jobs)
        table = markdown(runs, seed=options.seed)
        (kept / "chaos-live.md").write_text(table)
        sys.stdout.write(table)
    enough = sum(map(inside, runs)) >= ENOUGH_INSIDE * len(runs)
    return 0 if enough and all(map(covered, runs)) and all(map(whole, runs)) else 1


def ready_belt(kind: str, folder: Path, *, seed: int) -> Belt:
    """The belt with its truth, and its bias by an undisturbed replay."""
    folder.mkdir(parents=True, exist_ok=True)
    recording = make_belt(kind, folder, seed=seed)
    travel_of = make_belt("encoder", folder, seed=seed) if kind == "no encoder" else recording
    kept = folder / f"{travel_of.name}.undisturbed.json"
    if not kept.is_file():
        undisturbed = folder / f"{travel_of.name}-undisturbed"
        shutil.rmtree(undisturbed, ignore_errors=True)
        replay_recording(travel_of, out=undisturbed)
        score = score_run(undisturbed, truth=travel_of / "truth.json")
        kept.write_text(json.dumps(score.as_dict()) + "\n")
    score_kept = json.loads(kept.read_text())
    return Belt(
        recording,
        what_passed(recording, travel_of=travel_of),
        bias=score_kept["weight_g"] / score_kept["true_weight_g"],
    )


def run_all(cases: Sequence[Case], belts: dict[str, Belt], out: Path, *, jobs: int) -> list[dict[str, object]]:
    """Run the cases that have not run yet; all of them, by number."""
    out.mkdir(parents=True, exist_ok=True)
    table = out / "runs.jsonl"
    done = {run["number"]: run for run in map(json.loads, table.read_text().splitlines())} if table.is_file() else {}
    with ThreadPoolExecutor(jobs) as pool, table.open("a") as file:
        started = {}
        for case in cases:
            folder = out / f"{case.number:03d}"
            if case.number not in done:
                shutil.rmtree(folder, ignore_errors=True)
                started[pool.submit(live_line, case, belts[case.belt], folder)] = case
        for finished in as_completed(started):
            run = finished.result()
            done[run["number"]] = run
            file.write(json.dumps(run) + "\n")
            file.flush()
            print(told(run), flush=True)
    return [done[case.number] for case in cases]
