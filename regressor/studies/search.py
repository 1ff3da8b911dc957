"""Search for a recipe with Optuna, as in the paper: learning rate, weight decay, batch size and the loss's beta.

Every trial is a training of its own, judged by its validation error. Trials are kept in an SQLite file, so a search
goes on where it was stopped; a trial that was cut off is made again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from conveyor.errors import InputError
from conveyor.extras import needed
from regressor.training.begun import differences, digest_of
from regressor.training.cloudset import CloudSet
from regressor.training.recipe import TrainSettings
from regressor.training.train import Training, predict

STUDY = "pointraft"
TRIALS = 25
BATCHES = (16, 32, 64)
SEARCHED = ("lr", "weight_decay", "batch", "beta_g")


def search(
    data: CloudSet,
    validation: CloudSet,
    settings: TrainSettings,
    *,
    storage: Path,
    trials: int = TRIALS,
    on_step: Callable[[int, Training], None] = lambda number, training: None,
) -> list[dict[str, Any]]:
    """All finished trials, best first: number, validation MAE in grams and settings.

    Args:
        settings: everything that is not searched for. trials: finished ones in all, those of former calls included.
        storage: SQLite file.

    Raises:
        InputError: Optuna is not installed, too few views for the largest batch that is tried, or `storage` holds a
            search with other settings or on other views.
    """
    optuna = needed("optuna", extra="train", what="a search")
    # Of a trial that ends early it warns with a traceback; who ends it is told by what is raised.
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    if len(data) < max(BATCHES):
        raise InputError(f"{len(data)} training views are fewer than the largest batch that is tried, {max(BATCHES)}")

    def mae_g(trial: Any) -> float:
        tried = replace(settings, **suggested(trial))
        training = Training(data, validation, tried)
        while training.share < 1.0:
            training.step()
            on_step(trial.number, training)
        predicted = predict(
            training.finished_model(),
            validation,
            highest_m=tried.max_height_m,
            points=tried.points,
            resolution=tried.full,
        )
        return float(np.abs(predicted - validation.weight_g).mean())

    storage.parent.mkdir(parents=True, exist_ok=True)
    study = optuna.create_study(
        study_name=STUDY,
        storage=f"sqlite:///{storage}",
        direction="minimize",
        load_if_exists=True,
        # Seeded by what is there, so that a search that goes on does not repeat its first draws.
        sampler=optuna.samplers.TPESampler(seed=settings.seed + _finished(storage)),
    )
    _same_search(study, data, validation, settings, storage)
    done = [trial for trial in study.trials if trial.state == optuna.trial.TrialState.COMPLETE]
    if len(done) < trials:
        study.optimize(mae_g, n_trials=trials - len(done))
    finished = [trial for trial in study.trials if trial.state == optuna.trial.TrialState.COMPLETE]
    rows = [{"trial": trial.number, "val_mae_g": trial.value, **trial.params} for trial in finished]
    return sorted(rows, key=lambda row: float(row["val_mae_g"]))


def _same_search(study: Any, data: CloudSet, validation: CloudSet, settings: TrainSettings, storage: Path) -> None:
    """Refuse to go on with a search whose trials cannot be held against the next ones; note what a new one is.

    Raises:
        InputError: names what differs.
    """
    fixed = {name: value for name, value in asdict(settings).items() if name not in SEARCHED}
    given = {**fixed, "training views": digest_of(data), "validation views": digest_of(validation)}
    changed = differences(study.user_attrs.get("settings", {}), given)
    if changed:
        raise InputError(
            f"the search in {storage} was begun otherwise: {'; '.join(changed)}. Trials are compared with each other: "
            "give the options of its first call, or begin another one with another --out"
        )
    if not study.user_attrs:
        study.set_user_attr("settings", given)


def suggested(trial: Any) -> dict[str, Any]:
    """The settings that are searched for, as the paper names them."""
    return {
        "lr": trial.suggest_float("lr", 1e-4, 1e-2, log=True),
        "weight_decay": trial.suggest_float("weight_decay", 1e-6, 1e-2, log=True),
        "batch": trial.suggest_categorical("batch", BATCHES),
        "beta_g": trial.suggest_float("beta_g", 2.0, 50.0, log=True),
    }


def _finished(storage: Path) -> int:
    import optuna

    if not storage.is_file():
        return 0
    try:
        return len(optuna.load_study(study_name=STUDY, storage=f"sqlite:///{storage}").trials)
    except KeyError:
        return 0
