"""`tuberline calibrate belt`: where the belt is, and whether what was measured can be used."""

from __future__ import annotations

import json as json_module
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from conveyor.errors import InputError
from tuberline.cli.numbers import within
from tuberline.cli.recordings import tell_doubts

if TYPE_CHECKING:
    from rich.table import Table

    from segmenter.calibrate import BeltCalibration
    from segmenter.calibration_verdict import Verdict


def calibrate_belt(recording: Path, /, *, frames: Annotated[int, within(1, 100_000)] = 30, json: bool = False) -> None:
    """Measure where the belt is, from a recording of it, empty or running, and judge the measurement by its limits.

    Exits with 2, and gives no pose, where what was measured can be no belt.

    Parameters
    ----------
    recording
        Recording of any kind that `replay` takes.
    frames
        How many of the first frames to use.
    json
        Print the calibrations as JSON on stdout, belt_from_camera and verdict included.
    """
    from dataclasses import asdict

    from segmenter.calibrate import calibrate_recording
    from segmenter.calibration_verdict import verdict
    from tuberline.cli.progress import frames_bar

    tell_doubts(recording, masks=False)
    with frames_bar() as on_frame:
        results = calibrate_recording(recording, frames=frames, on_frame=on_frame)
    verdicts = [verdict(result) for result in results]
    if not json:
        from rich.console import Console

        console = Console(stderr=True)
        console.print(_table(results, verdicts))
        for result, judged in zip(results, verdicts, strict=True):
            for text in (*judged.findings, *_unreadable(result)):
                console.print(f"camera '{result.camera}': {text}", markup=False, highlight=False, soft_wrap=True)
    refused = [r.camera for r, judged in zip(results, verdicts, strict=True) if judged.word == "refused"]
    if refused:
        why = "" if not json else ": " + "; ".join(text for judged in verdicts for text in judged.findings)
        raise InputError(f"{recording}: no calibration of camera {', '.join(refused)}{why}")
    if json:
        told = [{**r.as_dict(), **asdict(judged)} for r, judged in zip(results, verdicts, strict=True)]
        for row in told:
            row["verdict"] = row.pop("word")
        sys.stdout.write(json_module.dumps(told, indent=2) + "\n")
        return
    for result, judged in zip(results, verdicts, strict=True):
        words = f"camera '{result.camera}' is {judged.word}: belt_distance_m = {result.belt_distance_m:.4f}"
        sys.stdout.write(f"{words} (the pose with --json)\n")


def _table(results: Sequence[BeltCalibration], verdicts: Sequence[Verdict]) -> Table:
    """One column per camera, and the limits."""
    from rich.markup import escape
    from rich.table import Table

    from conveyor.formats.inspection import FARTHEST_M, NEAREST_M
    from segmenter.calibration_verdict import LIMITS

    table = Table("", *(escape(r.camera) for r in results), "good", "refused")
    table.add_row("frames", *(f"{r.frames} of {r.asked}" for r in results), "", "")
    distances = [f"{r.belt_distance_m:.4f} m" for r in results]
    table.add_row("belt distance", *distances, "", f"outside {NEAREST_M:g} to {FARTHEST_M:g} m")
    for limit in LIMITS:
        measured = [f"{limit.value(r):.2f} {limit.unit}" for r in results]
        if limit.name == "off what is given":
            measured = ["-" if r.disagreement_mm is None else f"{r.disagreement_mm:+.1f} mm" for r in results]
        table.add_row(limit.name, *measured, f"to {limit.fine:g}", f"over {limit.most:g}")
    table.add_row("verdict", *(judged.word for judged in verdicts), "", "")
    return table


def _unreadable(result: BeltCalibration) -> list[str]:
    from conveyor.formats.cameras import told_unreadable

    return [text] if (text := told_unreadable(result.unreadable, result.first_fault)) else []
