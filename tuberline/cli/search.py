"""`tuberline search`: a search for a recipe."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tuberline.cli.numbers import Many, Seed
from tuberline.cli.twin_told import tell_parts_left_out, tell_twin

if TYPE_CHECKING:
    from rich.table import Table


def search(
    *,
    data: Path,
    val: Path,
    out: Path,
    trials: Many = 25,
    epochs: float | None = None,
    minutes: float | None = None,
    recipe: Literal["tuberline", "paper"] = "tuberline",
    compute: Literal["float32", "bfloat16"] = "float32",
    cache: Path | None = None,
    max_validation_views: Many = 2000,
    seed: Seed = 133,
    json: bool = False,
) -> None:
    """Search for learning rate, weight decay, batch size and the loss's beta with Optuna, as in the paper.

    Stop it at any time: the same command goes on where it was.

    Parameters
    ----------
    data
        Training views, as for `train`.
    val
        Validation views: the mean absolute error on them is what is made small.
    out
        Folder of search.db (Optuna's storage), search.json and the prepared clouds.
    trials
        How many in all, with those of former calls; one whose training diverges counts as a failed one.
    epochs
        Per trial.
    minutes
        Per trial, by the clock.
    recipe
        Where everything that is not searched for comes from.
    compute
        As for `train`.
    cache
        Folder of prepared clouds; default: in --out.
    max_validation_views
        Taken evenly over the validation set.
    seed
        Of everything random.
    json
        Print the trials as JSON on stdout.
    """
    import torch
    from rich.console import Console

    from conveyor.files import whole_output
    from regressor.studies.search import FAILED
    from regressor.studies.search import search as run
    from regressor.training.beginning import gone_where_refused
    from regressor.training.plausible import refused_told
    from regressor.training.recipe import recipe_named
    from regressor.training.run import RunOptions, keep_memory, load_sets
    from tuberline.cli.training_bar import TrainingBar

    tell_twin(data, val)
    torch.set_num_threads(1)
    keep_memory()
    settings = recipe_named(recipe, shear=None, epochs=epochs, minutes=minutes, compute=compute, seed=seed)
    options = RunOptions(data, val, out, "search", False, 1e9, 1e9, max_validation_views, "", cache)
    with gone_where_refused(out), TrainingBar() as bar:
        sets = load_sets(options, bar.prepared, keep=settings.kept_points)
    told = (refused_told(views.refused, views.refused_first) for views in sets)
    tell_parts_left_out(dict(zip(("training", "validation"), told, strict=True)))
    with TrainingBar() as bar:
        rows = run(
            *sets,
            settings,
            storage=out / "search.db",
            trials=trials,
            on_step=lambda number, training: bar.step(training, f"trial {number}"),
        )
    with whole_output(out / "search.json") as partial:
        partial.write_text(json_module.dumps(rows, indent=1) + "\n", encoding="utf-8")
    if json:
        sys.stdout.write(json_module.dumps(rows, indent=1) + "\n")
    else:
        Console().print(trial_table(rows))
    if failed := [row for row in rows if row["val_mae_g"] is None]:
        sys.stderr.write(
            f"{len(failed)} of {len(rows)} trials failed, trial {failed[0]['trial']} for one: {failed[0][FAILED]}. All "
            f"reasons are in {out / 'search.json'}\n"
        )


def trial_table(rows: list[dict[str, Any]]) -> Table:
    """A row for each trial that `regressor.studies.search.search` gives."""
    from rich.table import Table

    table = Table("trial", "validation MAE g", "lr", "weight decay", "batch", "beta g")
    for row in rows:
        figures = (f"{row[name]:.3g}" for name in ("lr", "weight_decay", "batch", "beta_g"))
        mae_g = "failed" if row["val_mae_g"] is None else f"{row['val_mae_g']:.2f}"
        table.add_row(str(row["trial"]), mae_g, *figures)
    return table
