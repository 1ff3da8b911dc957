"""`tuberline demo`: a simulated belt through the whole line, and how far the result was from the truth."""

from __future__ import annotations

import json as json_module
import sys
import time
from pathlib import Path
from typing import Annotated, Any

from tuberline.cli.numbers import within
from tuberline.replayer import replay_recording


def demo(
    *, out: Path = Path("out/demo"), regressors: Annotated[int, within(1, 64)] | None = None, json: bool = False
) -> None:
    """Two overlapping cameras look at two lanes of potatoes; every process of a real line counts and weighs them.

    Parameters
    ----------
    out
        Folder for the recording (made once) and the results of each run.
    regressors
        Number of weighing processes; default: two, or one on a single processor.
    json
        Print the result as JSON on stdout.
    """
    from rich.console import Console

    console = Console(stderr=json)
    recording = out / "recording"
    if not (recording / "truth.json").is_file():
        from conveyor.files import whole_output
        from tuberline.demo import demo_recording

        console.print(
            f"simulating a two-lane belt under two overlapping cameras into {recording} ...",
            markup=False,
            highlight=False,
        )
        with whole_output(recording) as partial:
            demo_recording(partial)
    run_dir = next_run(out)
    rrd = run_dir / "demo.rrd" if has_rerun() else None
    started = time.monotonic()
    summary = replay_recording(recording, out=run_dir, speed=0.0, regressors=regressors, rrd=rrd, show=not json)
    took_s = time.monotonic() - started
    result = score(run_dir, recording / "truth.json")
    if json:
        report = {"summary": summary, "score": result, "took_s": round(took_s, 1), "out": str(run_dir)}
        sys.stdout.write(json_module.dumps(report, indent=2) + "\n")
        return
    from conveyor.extras import install_hint
    from tuberline.cli.report import print_score, print_summary

    print_summary(console, summary, out=run_dir)
    print_score(console, result)
    if rrd:
        console.print(f"what happened, frame by frame: rerun {rrd}", markup=False, highlight=False)
    else:
        console.print(f"for a Rerun recording of the run too, {install_hint('viewer')}", markup=False, highlight=False)
    console.print(f"the run took {took_s:.1f} s", highlight=False)


def next_run(out: Path) -> Path:
    """The first of `out`/run-1, run-2, ... that holds no ledger yet."""
    n = 1
    while (out / f"run-{n}" / "ledger.db").exists():
        n += 1
    return out / f"run-{n}"


def has_rerun() -> bool:
    """Rerun is installed (looked up without importing it: that takes a second)."""
    from importlib.util import find_spec

    return find_spec("rerun") is not None


def score(run_dir: Path, truth: Path) -> dict[str, Any]:
    """The run against the truth, as `tuberline score --json` says it."""
    from aggregator.scoring.score import score_run

    return score_run(run_dir, truth=truth).as_dict()
