"""The command that trains the segmenter's networks."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import Literal

from conveyor.errors import InputError


def train_eyes(
    *,
    data: list[Path],
    val: Path,
    out: Path,
    net: Literal["judge", "cells"] = "judge",
    epochs: int = 40,
    steps: int = 2400,
    seed: int = 1,
    name: str | None = None,
    json: bool = False,
) -> None:
    """Train one of the segmenter's networks on simulated belts: minutes of one core.

    Parameters
    ----------
    data
        Belts to learn from, made by `tuberline simulate-belts`; may be given more than once.
    val
        Other belts to judge it by.
    out
        Folder of <name>.onnx, for `segmenter.weights` of a line's file, and <name>.json.
    net
        judge: tells tubers from clods, stones and haulm, track by track. cells: finds tubers, for segmenter.method
        "learned".
    epochs
        Of the judge: passes over all bodies.
    steps
        Of the cells: steps of 8 crops.
    seed
        Of the first weights and of all draws.
    name
        Name of the files; default: tuberline-eyes for the judge, tuberline-cells for the cells.
    json
        Print the sidecar as JSON on stdout.
    """
    from rich.console import Console
    from rich.progress import Progress

    from segmenter.learn.cells_train import CellsRecipe
    from segmenter.learn.judge_net import JudgeRecipe
    from segmenter.learn.run import EyesRun, make_cells, make_judge

    if steps < 20 or epochs < 1:
        raise InputError(f"--steps {steps} --epochs {epochs}: at least 20 steps and 1 epoch are needed")
    run = EyesRun(
        tuple(data), val, out, name or ("tuberline-eyes" if net == "judge" else "tuberline-cells"),
        " ".join(["tuberline", *sys.argv[1:]]),
    )  # fmt: skip
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("reading belts", total=None)

        def on_step(step: int, total: int, loss: float) -> None:
            progress.update(task, completed=step, total=total, description=f"loss {loss:.3f}")

        if net == "judge":
            sidecar = make_judge(run, JudgeRecipe(epochs=epochs, seed=seed), on_step=on_step)
        else:
            sidecar = make_cells(run, CellsRecipe(steps=steps, seed=seed), on_step=on_step)
    if json:
        sys.stdout.write(json_module.dumps(sidecar, indent=1) + "\n")
        return
    sys.stdout.write(f"{out / run.name}.onnx, on belts never seen:\n")
    for what, value in sidecar["held_out"].items():
        sys.stdout.write(f"  {what}: {value:.4g}\n")
