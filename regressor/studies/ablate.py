"""The paper's ablations and the other networks, by name: trained with one recipe, evaluated in one table."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from conveyor.errors import InputError
from conveyor.files import whole_output
from conveyor.text_files import read_json
from regressor.network.stored import read_weights
from regressor.studies.alone import load_scale
from regressor.studies.evaluate import (
    LINEAR_BOX,
    NETWORK,
    PRODUCT,
    VISIBLE_VOLUME,
    VOLUME_RULE,
    evaluate,
    method_scores,
)
from regressor.training.begun import differences, digest_of
from regressor.training.labelled import labelled_files, part_of
from regressor.training.plausible import refused_told
from regressor.training.recipe import TrainSettings
from regressor.training.run import STATE, WEIGHTS, RunOptions, load_sets, train
from regressor.training.train import Training

VARIANTS: dict[str, dict[str, Any]] = {
    "full": {},
    "no-height": {"height_embedding": False},
    "pointnet": {"network": "pointnet"},
    "no-dropout": {"dropout": 0.0},
    "512-points": {"points": 512},
    "2048-points": {"points": 2048},
}
MEANING = {
    "full": "PointRAFT",
    "no-height": "PointNet++: without the height embedding",
    "pointnet": "PointNet (Qi et al. 2017), 1024 points, no height",
    "no-dropout": "PointRAFT without dropout",
    "512-points": "PointRAFT on 512 points",
    "2048-points": "PointRAFT on 2048 points",
}
RULES = (VOLUME_RULE, VISIBLE_VOLUME, PRODUCT, LINEAR_BOX)
PAPER = {"full": (12.0, 17.2, 0.97), LINEAR_BOX: (23.0, 31.8, 0.91)}
"""MAE g, RMSE g, R2 per view on the paper's real test set, as far as they are known to this project."""

COLUMNS = ("mae_g", "rmse_g", "bias_g", "r2", "tuber_mae_g", "load_bias_percent")
Table = dict[str, dict[str, float]]


def ablate(
    names: Sequence[str],
    settings: TrainSettings,
    options: RunOptions,
    *,
    test: Path,
    max_views: int | None,
    on_step: Callable[[str, Training], None],
    on_left_out: Callable[[str, str], None] = lambda part, words: None,
) -> Table:
    """Figures on `test` per variant, each network alone, and of the rules they have to beat.

    Weights already in `<out>/<name>` are not trained again. The table is written after every variant.

    Args:
        on_left_out: called for each variant with 'training', 'validation' or 'test', and which of those views are left
            out, in words; not where none are.

    Raises:
        InputError: a name that is not known, no views in `test`, or weights there of another recipe or other training
            views.
    """
    unknown = [name for name in names if name not in VARIANTS]
    if unknown:
        raise InputError(f"unknown ablation {', '.join(unknown)}; known: {', '.join(VARIANTS)}")
    labelled_files(test, split=part_of(test, "test"))  # before hours of training
    options = replace(options, cache=options.cache or options.out / "cache")
    _check_finished(names, settings, options)
    table: Table = {}
    rules: Table = {}
    for name in names:
        scale = load_scale(_trained(name, settings, options, on_step))
        judged = evaluate(test, scale, split=part_of(test, "test"), max_views=max_views)
        figures, trained = method_scores(judged), scale.sidecar.training
        for part, words in (
            *trained.get("left_out", {}).items(),
            ("test", refused_told(judged.refused, judged.refused_first)),
        ):
            if words:
                on_left_out(part, words)
        table[name] = {**figures[NETWORK], "steps": float(trained["steps"]), "hours": float(trained["hours"])}
        rules = rules or {rule: figures[rule] for rule in RULES if rule in figures}
        write_table(options.out, {**table, **rules}, _recipe_words(settings, options, test))
    return {**table, **rules}


def _is_finished(out: Path) -> bool:
    """A state says that a training is unfinished; without it the weights are final."""
    return (out / WEIGHTS).is_file() and not (out / STATE).is_file()


def _check_finished(names: Sequence[str], settings: TrainSettings, options: RunOptions) -> None:
    """Before hours of training: a table compares trainings by one recipe on the same views.

    Raises:
        InputError: finished weights are of another one.
    """
    finished = [name for name in names if _is_finished(options.out / name)]
    views = digest_of(load_sets(options, lambda what, done: None)[0]) if finished else ""
    for name in finished:
        weights = options.out / name / WEIGHTS
        trained = read_weights(weights)[1].training
        changed = differences(trained.get("settings", {}), asdict(_of_variant(settings, name)))
        if trained.get("data", views) != views:
            changed.append("other training views")
        if changed:
            raise InputError(
                f"{weights} was trained otherwise: {'; '.join(changed)}. A table compares trainings by one recipe: "
                "give the options that it was trained with, or another --out"
            )


def _of_variant(settings: TrainSettings, name: str) -> TrainSettings:
    return replace(settings, **VARIANTS[name])


def _trained(name: str, settings: TrainSettings, options: RunOptions, on_step: Callable[[str, Training], None]) -> Path:
    out = options.out / name
    if _is_finished(out):
        return out / WEIGHTS
    train(
        replace(options, out=out, name=name, resume=(out / STATE).is_file()),
        _of_variant(settings, name),
        on_prepared=lambda what, done: None,
        on_step=lambda training: on_step(name, training),
        on_validated=lambda training, metrics: None,
    )
    (out / STATE).unlink()
    return out / WEIGHTS


def _recipe_words(settings: TrainSettings, options: RunOptions, test: Path) -> str:
    length = f"{settings.minutes:g} minutes" if settings.minutes is not None else f"{settings.epochs:g} epochs"
    return (
        f"Trained on `{options.data.name}` for {length} each (batches of {settings.batch}, first learning rate "
        f"{settings.lr:g}, {settings.compute} products, seed {settings.seed}), judged on `{test.name}`. A variant "
        "whose weights were there already keeps its own number of steps."
    )


def write_table(out: Path, table: Table, recipe: str) -> None:
    """Write ablation.json and ablation.md; where one cannot be written its former form stays.

    Raises:
        InputError: says which. OutputError: their disk is full, read-only, away or reports errors.
    """
    files = {
        "ablation.json": json.dumps({"recipe": recipe, "table": table}, indent=1) + "\n",
        "ablation.md": markdown(table, recipe=recipe),
    }
    for name, text in files.items():
        with whole_output(out / name) as partial:
            partial.write_text(text, encoding="utf-8")


def read_table(out: Path) -> tuple[Table, str]:
    """(table, words on the recipe) that `ablate` left in `out`.

    Raises:
        InputError: none there.
    """
    stored = read_json(out / "ablation.json", what="table of `tuberline ablate`")
    try:
        return stored["table"], stored["recipe"]
    except (KeyError, TypeError) as error:
        raise InputError(f"{out} holds no ablation.json of `tuberline ablate`: {error!r}") from error


def markdown(table: Table, *, recipe: str) -> str:
    """The table for people: each network alone, the rules, and the paper's figures on its own real data beside them."""
    lines = [
        recipe,
        "",
        "| variant | steps | MAE g | RMSE g | bias g | R2 | MAE g per tuber | load bias % | paper: MAE, RMSE, R2 |",
        "|" + " --- |" * 9,
    ]
    for name, figures in table.items():
        label = f"{name}: {MEANING[name]}" if name in MEANING else name
        steps = f"{figures['steps']:.0f}" if "steps" in figures else "–"
        paper = "{:.1f} g, {:.1f} g, {:.2f}".format(*PAPER[name]) if name in PAPER else "not known"
        cells = [label, steps, *(f"{figures[column]:.3f}" for column in COLUMNS), paper]
        lines.append("| " + " | ".join(cells) + " |")
    lines += [
        "",
        "The paper's figures are from 859 real tubers, ours from simulated ones: compare the order and the ratios. "
        "'Not known': its abstract gives the two, its ablation table was not at hand. The number of points changes "
        "nothing but that of second-stage centroids, for all neighbours are among a cloud's first 64 points.",
    ]
    return "\n".join(lines) + "\n"
