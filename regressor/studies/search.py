"""Search for a recipe with Optuna, as in the paper: learning rate, weight decay, batch size and the loss's beta.

Every trial is a training of its own, judged by its validation error. Trials are kept in an SQLite file, so a search
goes on where it was stopped; a trial that was cut off is made again. One whose training diverged is a failed trial: a
high learning rate is tried like any other.
"""

from __future__ import annotations

import math
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
from regressor.training.train import Diverged, Training

STUDY = "pointraft"
TRIALS = 25
BATCHES = (16, 32, 64)
FAILED = "failed"
"""Key of a failed trial's reason: Optuna takes one that was cut off for a failed one, too."""
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
    """All trials, best first: number, validation MAE in grams and settings; last those that failed, with the reason.

    Args:
        settings: everything that is not searched for. trials: how many in all, those of former calls included.
        storage: SQLite file.

    Raises:
        InputError: Optuna is not installed, too few views for the largest batch that is tried, or `storage` holds
            something else, or a search with other settings or on other views.
    """
    optuna = needed("optuna", extra="train", what="a search")
    # Of a trial that ends early it warns with a traceback; who ends it is told by what is raised.
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    if len(data) < max(BATCHES):
        raise InputError(f"{len(data)} training views are fewer than the largest batch that is tried, {max(BATCHES)}")

    def mae_g(trial: Any) -> float:
        training = Training(data, validation, replace(settings, **suggested(trial)))
        try:
            while training.share < 1.0:
                training.step()
                on_step(trial.number, training)
            _, predicted = training.validated()
        except Diverged as error:
            trial.set_user_attr(FAILED, str(error))
            raise
        return float(np.abs(predicted - validation.weight_g).mean())

    study = _opened(storage, settings.seed)
    _same_search(study, data, validation, settings, storage)
    if (missing := trials - len(_trials(study))) > 0:
        study.optimize(mae_g, n_trials=missing, catch=(Diverged,))
    return sorted(_trials(study), key=lambda row: math.inf if row["val_mae_g"] is None else row["val_mae_g"])


def _trials(study: Any) -> list[dict[str, Any]]:
    """Those that came to an end, in their order: `val_mae_g` is None of one that failed, and `failed` says why."""
    rows = []
    for trial in study.trials:
        why = trial.user_attrs.get(FAILED)
        if trial.state.name == "COMPLETE":
            rows.append({"trial": trial.number, "val_mae_g": trial.value, **trial.params})
        elif why is not None:
            rows.append({"trial": trial.number, "val_mae_g": None, **trial.params, FAILED: why})
    return rows


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


def _opened(storage: Path, seed: int) -> Any:
    """The study in `storage`; a new one where there is none.

    Raises:
        InputError: that file is another one.
    """
    import optuna
    from sqlalchemy.exc import SQLAlchemyError

    storage.parent.mkdir(parents=True, exist_ok=True)
    try:
        study = optuna.create_study(
            study_name=STUDY, storage=f"sqlite:///{storage}", direction="minimize", load_if_exists=True
        )
    except (SQLAlchemyError, optuna.exceptions.OptunaError, RuntimeError) as error:
        why = str(error).splitlines()[0]
        raise InputError(f"{storage} holds no search: {why}. Take it away, or give another --out") from error
    # Seeded by what is there, so that a search that goes on does not repeat its first draws.
    study.sampler = optuna.samplers.TPESampler(seed=seed + len(study.trials))
    return study
