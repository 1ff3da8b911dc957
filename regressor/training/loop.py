"""The loop around a training: steps to the end, validation and log on the way, the state written atomically."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from conveyor.errors import InputError
from conveyor.files import whole_output
from regressor.network.networks import Network
from regressor.training.train import Training

NEEDED = {"settings", "model", "average", "optimiser", "rng", "torch_rng", "progress"}
"""What a state holds at least, whichever version wrote it."""
LOG = "log.csv"
LOG_FIELDS = ("minutes", "step", "epoch", "share", "neighbours", "centroids", "lr", "loss", "val_loss", "val_mae_g")


def run_training(
    training: Training,
    *,
    out: Path,
    save_minutes: float,
    validate_minutes: float,
    on_validated: Callable[[Network, NDArray[np.float64], bool], None],
    on_step: Callable[[Training], None],
    stop: Callable[[], bool] = lambda: False,
) -> Network:
    """Train to the end; the finished model.

    Args:
        out: folder of `state.pt` and `log.csv`.
        validate_minutes: between two validations; a training for its best epoch validates after each epoch instead.
        on_validated: called with the model, its validation predictions and whether it is the best so far.
        on_step: called after every step.
        stop: asked between steps; once it says so the state is written.

    Raises:
        KeyboardInterrupt: `stop` said so.
    """
    if training.progress.step == 0:
        (out / LOG).unlink(missing_ok=True)  # of one that ended before its first state
    next_save = time.monotonic() + 60 * save_minutes
    next_validation = time.monotonic() + 60 * validate_minutes
    while training.share < 1.0 and not stop():
        epoch = int(training.epoch)
        training.step()
        on_step(training)
        due = int(training.epoch) > epoch if training.settings.best_epoch else time.monotonic() >= next_validation
        if due and training.share < 1.0:
            _validate(training, out, on_validated, final=False)
            next_validation = time.monotonic() + 60 * validate_minutes
        if time.monotonic() >= next_save:
            save_state(training, out / "state.pt")
            next_save = time.monotonic() + 60 * save_minutes
    save_state(training, out / "state.pt")
    if stop():
        raise KeyboardInterrupt
    return _validate(training, out, on_validated, final=True)


def _validate(
    training: Training,
    out: Path,
    on_validated: Callable[[Network, NDArray[np.float64], bool], None],
    *,
    final: bool,
) -> Network:
    model, predicted = training.validated(compute=None if final else training.compute)
    residual = torch.from_numpy(predicted - training.validation.weight_g)
    loss = float(nn.functional.smooth_l1_loss(residual, torch.zeros_like(residual), beta=training.settings.beta_g))
    mae = float(residual.abs().mean())
    progress = training.progress
    best = loss < progress.best_loss if training.settings.best_epoch else mae < progress.best_mae_g
    progress.best_mae_g, progress.best_loss = min(mae, progress.best_mae_g), min(loss, progress.best_loss)
    _log(training, out / LOG, loss, mae)
    on_validated(model, predicted, best)
    return model


def _log(training: Training, path: Path, val_loss: float, val_mae_g: float) -> None:
    """One more row of the log, which is written whole: a full disk leaves the former one."""
    progress, share = training.progress, training.share
    resolution = training.settings.resolution(share)
    rows = _rows_before(path, progress.step)
    epoch, rate = training.epoch, training.settings.learning_rate(share)
    figures = (share, resolution.neighbours, resolution.centroids, rate, progress.loss, val_loss, val_mae_g)
    rows.append([f"{progress.seconds / 60:.2f}", str(progress.step), f"{epoch:.3f}", *(f"{v:.5g}" for v in figures)])
    with whole_output(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([LOG_FIELDS, *rows])


def _rows_before(path: Path, step: int) -> list[list[str]]:
    """The log's rows of earlier steps: a training that goes on from a state logs once more what came after it."""
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        rows = [row for row in csv.reader(file) if len(row) == len(LOG_FIELDS)]
    return [row for row in rows if row[1].isdecimal() and int(row[1]) < step]


def save_state(training: Training, path: Path) -> None:
    """Write the state atomically: a crash leaves the former one."""
    data = io.BytesIO()
    torch.save(training.state(), data)  # into memory: on a full disk torch raises what is no error of a disk
    with whole_output(path) as partial:
        partial.write_bytes(data.getbuffer())


def load_state(path: Path) -> dict[str, Any]:
    """A state written by `save_state`.

    Raises:
        InputError: missing, unreadable, or no such state.
    """
    fix = "begin another training with another --out, or take that file away to begin again in its folder"
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises a wide, undocumented set for broken files
        raise InputError(f"training state {path} cannot be read: {error}. What it held is lost: {fix}") from error
    if not isinstance(state, dict) or not state.keys() >= NEEDED:
        raise InputError(f"{path} is none of a training, or of another version of this program: {fix}")
    return state
