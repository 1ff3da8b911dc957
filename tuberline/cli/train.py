"""`tuberline train`: train PointRAFT."""

from __future__ import annotations

import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from conveyor.errors import InputError
from tuberline.cli.numbers import Many, Seed, within
from tuberline.cli.stoppable import Request, leave, stoppable
from tuberline.cli.twin_told import tell_parts_left_out, tell_twin

if TYPE_CHECKING:
    from regressor.network.sidecar import Sidecar
    from regressor.training.recipe import TrainSettings
    from regressor.training.run import RunOptions
    from regressor.training.train import Training


def train(
    *,
    data: Path,
    val: Path,
    out: Path,
    recipe: Literal["tuberline", "paper", "fine-tune"] = "tuberline",
    start: Path | None = None,
    start_share: Annotated[float | None, within(0, 1)] = None,
    epochs: float | None = None,
    minutes: float | None = None,
    resume: bool = False,
    batch: int | None = None,
    lr: float | None = None,
    weight_decay: Annotated[float | None, within(0, 1)] = None,
    dropout: Annotated[float | None, within(0, 0.95)] = None,
    height_embedding: Annotated[bool, Parameter(negative="--no-height-embedding")] = True,
    shear: Annotated[float | None, within(0, 1)] = None,
    balanced: Annotated[bool | None, Parameter(negative="--no-balanced")] = None,
    compute: Literal["float32", "bfloat16"] = "float32",
    device: Literal["cpu", "cuda"] = "cpu",
    threads: Annotated[int, within(1, 64)] = 1,
    seed: Seed = 133,
    save_minutes: Annotated[float, within(0.01, 1e9, "min")] = 2.0,
    validate_minutes: Annotated[float, within(0.01, 1e9, "min")] = 5.0,
    max_validation_views: Many = 2000,
    name: str = "pointraft",
    target: Literal["weight_g", "volume_ml", "length_mm"] = "weight_g",
) -> None:
    """Train PointRAFT; writes weights.safetensors with its sidecar, log.csv and a state to resume from.

    Ctrl-C writes the state after the step under way, ends it with 130 and says how to go on. A second one ends it at
    once, with the state as it was written last.

    Parameters
    ----------
    data
        A folder of view packs (`tuberline simulate-views`) or a 3DPotatoTwin folder.
    val
        The same for validation. A folder with a splits.csv is read by its parts, for both.
    out
        Folder to write into.
    recipe
        Defaults of everything below: ours, the paper's, or ours for going on from trained weights.
    start
        Weights to begin with (.safetensors), for the recipe fine-tune; default: random ones.
    start_share
        Of the weights to start from, in what is written, 0 to 1: keeps what they knew (0).
    epochs
        Passes over the training views (50; 2 to fine-tune).
    minutes
        Train by the clock instead; the schedule adapts to the steps really made.
    resume
        Go on with the training in `out`.
    batch
        Clouds per step (32).
    lr
        First learning rate (1e-3).
    weight_decay
        Adam's L2 (1e-4).
    dropout
        In the head (paper 0.5, ours 0.1, none to fine-tune).
    height_embedding
        Feed the height above the belt; off for the paper's ablation.
    shear
        The paper's shear in all six directions (paper 0.2, ours 0: only in the belt's plane).
    balanced
        Draw the weight classes equally often; ours ends with the natural distribution.
    compute
        bfloat16 for the wide products is 2 to 3 times faster where the processor has it.
    device
        cuda where torch has a GPU.
    threads
        Of this process.
    seed
        Of everything random.
    save_minutes
        Between two writes of the state.
    validate_minutes
        Between two validations.
    max_validation_views
        Taken evenly over the validation set.
    name
        Of the weights, as it will stand in ledgers.
    target
        What is learned. A line weighs, so it takes weights for weight_g alone; `evaluate` takes all.
    """
    from regressor.training import run
    from regressor.training.recipe import recipe_named

    _check_start(recipe, start, start_share)
    settings = recipe_named(
        recipe,
        epochs=epochs,
        minutes=minutes,
        batch=batch,
        lr=lr,
        weight_decay=weight_decay,
        dropout=dropout,
        height_embedding=height_embedding,
        balanced=balanced,
        compute=compute,
        device=device,
        seed=seed,
        shear=shear,
        target=target,
        start_share=start_share,
    )
    options = run.RunOptions(
        data=data,
        validation=val,
        out=out,
        name=name,
        resume=resume,
        save_minutes=save_minutes,
        validate_minutes=validate_minutes,
        max_validation_views=max_validation_views,
        command=shlex.join(["tuberline", *sys.argv[1:]]),
        start=start,
    )
    tell_twin(data, val)
    _train(options, settings, threads)


def _train(options: RunOptions, settings: TrainSettings, threads: int) -> None:
    """Train, with a bar on stderr, and tell of what was made or stopped."""
    import torch

    from regressor.training import run
    from tuberline.cli.training_bar import TrainingBar

    torch.set_num_threads(threads)
    request, bar = Request(), TrainingBar()

    def step(training: Training) -> None:
        # Before the first step there is nothing to keep, after the last one its state is written at once.
        (request.heeds.set if training.share < 1.0 else request.heeds.clear)()
        bar.step(training)

    with stoppable(lambda: _stopped(options.out / run.STATE), request, on_request=bar.stopping) as stopped, bar:
        sidecar = run.train(
            options,
            settings,
            on_prepared=bar.prepared,
            on_step=step,
            on_validated=bar.validated,
            stop=request.made.is_set,
        )
    if stopped.is_set():
        leave()
    _tell(options.out / run.WEIGHTS, sidecar)


def _check_start(recipe: str, start: Path | None, start_share: float | None) -> None:
    """Refuse options that need each other."""
    if start_share is not None and start is None:
        raise InputError(f"--start-share {start_share:g} is of the network that --start names, and none is given")
    if (recipe == "fine-tune") != (start is not None):
        raise InputError("--recipe fine-tune and --start WEIGHTS belong together: give both or neither")


def _stopped(state: Path) -> str:
    """What a training that was stopped has left, and how to go on."""
    try:
        minutes = (time.time() - state.stat().st_mtime) / 60
    except FileNotFoundError:
        return "stopped before a first state was written (--save-minutes): no training is there to go on with"
    return f"stopped: --resume goes on from the state in {state.parent}, which was written {minutes:.1f} min ago"


def _tell(weights: Path, sidecar: Sidecar) -> None:
    """What was left out, how good the weights are, and what their intervals promise."""
    from regressor.training.tuber_interval import interval_told

    # Weights of a best epoch may be older than these keys.
    tell_parts_left_out(sidecar.training.get("left_out", {}))
    told = f"MAE {sidecar.metrics['validation']['mae_g']:.1f} {sidecar.unit} per view on the validation set"
    sys.stderr.write(f"{weights}: {told}\n")
    if counted := sidecar.metrics.get("interval"):
        sys.stderr.write(f"{interval_told(int(counted['tubers']), int(counted['recordings']))}\n")
