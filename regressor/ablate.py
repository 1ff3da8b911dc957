"""The paper's ablations by name: each variant is trained with the same recipe, then all are evaluated in one table."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from conveyor.errors import InputError
from regressor.evaluate import NETWORK, evaluate, method_scores
from regressor.recipe import TrainSettings
from regressor.train import Training
from regressor.trainrun import RunOptions, train
from regressor.weigher import Weigher

VARIANTS: dict[str, dict[str, Any]] = {
    "full": {},
    "no-height": {"height_embedding": False},
    "no-dropout": {"dropout": 0.0},
    "512-points": {"points": 512},
    "2048-points": {"points": 2048},
}
COLUMNS = ("mae_g", "rmse_g", "bias_g", "r2", "tuber_mae_g", "load_bias_percent")


def ablate(
    names: Sequence[str],
    settings: TrainSettings,
    options: RunOptions,
    *,
    test: Path,
    max_views: int | None,
    on_step: Callable[[str, Training], None],
) -> dict[str, dict[str, float]]:
    """Figures of the network alone per variant on `test`; weights already in `<out>/<name>` are not trained again.

    Raises:
        InputError: a name that is not known.
    """
    unknown = [name for name in names if name not in VARIANTS]
    if unknown:
        raise InputError(f"unknown ablation {', '.join(unknown)}; known: {', '.join(VARIANTS)}")
    table: dict[str, dict[str, float]] = {}
    for name in names:
        weights = _trained(name, settings, options, on_step)
        table[name] = method_scores(evaluate(test, Weigher.load(weights), max_views=max_views))[NETWORK]
        (options.out / "ablation.json").write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
        (options.out / "ablation.md").write_text(markdown(table), encoding="utf-8")
    return table


def _trained(name: str, settings: TrainSettings, options: RunOptions, on_step: Callable[[str, Training], None]) -> Path:
    out = options.out / name
    weights = out / "weights.safetensors"
    state = out / "state.pt"
    if weights.is_file() and not state.is_file():
        return weights
    train(
        replace(options, out=out, name=name, resume=state.is_file()),
        replace(settings, **VARIANTS[name]),
        on_prepared=lambda what, done: None,
        on_step=lambda training: on_step(name, training),
        on_validated=lambda training, metrics: None,
    )
    # A state says that a training is unfinished; without it the weights are final.
    state.unlink()
    return weights


def markdown(table: dict[str, dict[str, float]]) -> str:
    """The table for people."""
    lines = ["| variant | MAE g | RMSE g | bias g | R2 | MAE g per tuber | load bias % |", "|" + " --- |" * 7]
    for name, figures in table.items():
        lines.append("| " + " | ".join([name, *(f"{figures[column]:.3f}" for column in COLUMNS)]) + " |")
    return "\n".join(lines) + "\n"
