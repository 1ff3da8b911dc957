"""Commands around a training: intervals, splits, search for a recipe, ablations, drift, and the page of results."""

from __future__ import annotations

import json as json_module
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

if TYPE_CHECKING:
    import torch


def _wide(compute: str) -> torch.dtype | None:
    import torch

    return torch.bfloat16 if compute == "bfloat16" else None


def calibrate_interval(
    weights: Path,
    /,
    *,
    data: Path,
    cache: Path | None = None,
    max_views: int | None = None,
    compute: Literal["float32", "bfloat16"] = "float32",
) -> None:
    """Calibrate the intervals of saved weights on views with known weights; rewrites the sidecar, not the tensors.

    A training does the same at its end on its validation views. Give tubers that no training has seen, as the line
    meets them; never the set that the weights are judged on.

    Parameters
    ----------
    weights
        The .safetensors file; its .json sidecar lies beside it.
    data
        A folder of view packs (`tuberline simulate-views`) or a 3DPotatoTwin folder.
    cache
        Folder of prepared clouds, to save the preparing; default: none.
    max_views
        Taken evenly over the set.
    compute
        As for `train`.
    """
    import torch

    from regressor.training.calibration import recalibrate

    torch.set_num_threads(1)
    sidecar = recalibrate(weights, data, cache=cache, max_views=max_views, compute=_wide(compute))
    figures = sidecar.metrics["calibration"]
    sys.stderr.write(
        f"{weights.with_suffix('.json')}: calibrated on {figures['views']:.0f} views of {figures['tubers']:.0f} "
        f"tubers; views of a tuber share {100 * sidecar.shared_sd_share:.0f} % of an error, tubers of a load "
        f"{100 * sidecar.shared_bias_share:.1f} % of its weight\n"
    )


def calibrate_blend(
    weights: Path,
    /,
    *,
    data: Path,
    unseen: Path,
    cache: Path | None = None,
    compute: Literal["float32", "bfloat16"] = "float32",
) -> None:
    """Fit the volume rule of saved weights and its blend with the network anew; rewrites the sidecar, not the tensors.

    Calibrate the intervals after it, on other views again (`tuberline calibrate-interval`).

    Parameters
    ----------
    weights
        The .safetensors file; its .json sidecar lies beside it.
    data
        Views for the rule alone: a folder of view packs, those that the network was trained on say.
    unseen
        Views of recordings that the network has not seen, for the rule and the blend.
    cache
        Folder of prepared clouds, to save the preparing; default: none.
    compute
        As for `train`.
    """
    import torch

    from regressor.training.stacking import restack

    torch.set_num_threads(1)
    sidecar = restack(weights, data, unseen, cache=cache, compute=_wide(compute))
    figures = sidecar.metrics["blend"]
    sys.stderr.write(
        f"{weights.with_suffix('.json')}: {100 * (1 - sidecar.volume_share):.0f} % network, "
        f"{100 * sidecar.volume_share:.0f} % volume rule; MAE {figures['mae_g']:.2f} g on the unseen views\n"
    )


def split(folder: Path, /, *, seed: int = 20, force: bool = False) -> None:
    """Share the tubers of a 3DPotatoTwin folder out 60/20/20 over training, validation and test; writes splits.csv.

    Stratified by ten weight classes of equal size, as in the paper. The draw is our own: keep the splits.csv of the
    authors' download where there is one.

    Parameters
    ----------
    folder
        With ground_truth.csv.
    seed
        Of the draw.
    force
        Overwrite a splits.csv that is there.
    """
    from regressor.training.split import write_splits

    counts = write_splits(folder, seed=seed, force=force)
    sys.stdout.write(f"{folder / 'splits.csv'}: {', '.join(f'{name} {count}' for name, count in counts.items())}\n")


def search(
    *,
    data: Path,
    val: Path,
    out: Path,
    trials: int = 25,
    epochs: float | None = None,
    minutes: float | None = None,
    recipe: Literal["tuberline", "paper"] = "tuberline",
    compute: Literal["float32", "bfloat16"] = "float32",
    cache: Path | None = None,
    max_validation_views: int = 2000,
    seed: int = 133,
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
        Finished trials in all, with those of former calls.
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
    from rich.table import Table

    from regressor.studies.search import search as run
    from regressor.training.recipe import recipe_named
    from regressor.training.run import RunOptions, keep_memory, load_sets
    from tuberline.cli.training_bar import TrainingBar

    torch.set_num_threads(1)
    keep_memory()
    settings = recipe_named(recipe, shear=None, epochs=epochs, minutes=minutes, compute=compute, seed=seed)
    options = RunOptions(data, val, out, "search", False, 1e9, 1e9, max_validation_views, "", cache)
    with TrainingBar() as bar:
        sets = load_sets(options, bar.prepared, keep=settings.kept_points)
        rows = run(
            *sets,
            settings,
            storage=out / "search.db",
            trials=trials,
            on_step=lambda number, training: bar.step(training, f"trial {number}"),
        )
    (out / "search.json").write_text(json_module.dumps(rows, indent=1) + "\n", encoding="utf-8")
    if json:
        sys.stdout.write(json_module.dumps(rows, indent=1) + "\n")
        return
    table = Table("trial", "validation MAE g", "lr", "weight decay", "batch", "beta g")
    for row in rows:
        figures = (f"{row[name]:.3g}" for name in ("lr", "weight_decay", "batch", "beta_g"))
        table.add_row(str(row["trial"]), f"{row['val_mae_g']:.2f}", *figures)
    Console().print(table)


def drift(
    *,
    data: Path,
    out: Path,
    also: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    weights: Path | None = None,
    max_views: int | None = 600,
    seed: int = 0,
    json: bool = False,
) -> None:
    """Evaluate weights on views that drift from their training: belt height, noise, kinds of tuber, belt distance.

    Reports the error of a view and the bias of the total, which is what drift ruins.

    Parameters
    ----------
    data
        A folder of view packs that no training has seen.
    out
        Folder of drift.json and drift.md.
    also
        Further packs as NAME=FOLDER, e.g. "belt at 0.60 m=packs/far" (`tuberline simulate-views --distances 0.60
        --camera d405-1280`).
    weights
        A .safetensors or an upstream .pth file; default: the shipped ones.
    max_views
        Of each shift, the first so many.
    seed
        Of the noise.
    json
        Print the figures as JSON on stdout.
    """
    import torch
    from rich.console import Console
    from rich.markdown import Markdown

    from conveyor.errors import InputError
    from regressor.studies.drift import drift as run
    from regressor.studies.drift import write_drift
    from regressor.weigh.weigher import Weigher

    torch.set_num_threads(1)
    others = dict(text.partition("=")[::2] for text in also or [])
    if not all(others.values()):
        raise InputError(f"--also {' '.join(also or [])}: every further pack is NAME=FOLDER")
    console = Console(stderr=True)
    with console.status("weighing") as status:
        measured = run(
            data,
            {name: Path(folder) for name, folder in others.items()},
            Weigher.load(weights),
            max_views=max_views,
            seed=seed,
            on_shift=lambda name: status.update(name),
        )
    text = write_drift(measured, out)
    if json:
        sys.stdout.write(json_module.dumps(measured, indent=1) + "\n")
    else:
        Console().print(Markdown(text))


def evaluation_page(
    *,
    out: Path,
    field: Path,
    easy: Path,
    one_season: Path | None = None,
    ablation: Path | None = None,
    drift: Path | None = None,
    speed: Path | None = None,
    image: str | None = None,
) -> None:
    """Make docs/evaluation.md from saved results; nothing is measured anew.

    Parameters
    ----------
    out
        The Markdown file to write.
    field
        Folder of `tuberline evaluate` on field views.
    easy
        The same on easy views.
    one_season
        The same on field views of one season (`--season`): as hard for the paper's linear rule as the paper's data.
    ablation
        Folder of `tuberline ablate`.
    drift
        Folder of `tuberline drift`.
    speed
        Folder of `python -m benchmarks regressor --out`.
    image
        Link to the picture of the field evaluation, relative to the page.
    """
    from regressor.studies.page import evaluation_page as page

    text = page(field, easy, one_season=one_season, ablation=ablation, drift=drift, speed=speed, image=image)
    out.write_text(text, encoding="utf-8")
    sys.stderr.write(f"{out} written\n")


def ablate(
    *names: str,
    data: Path,
    val: Path,
    test: Path,
    out: Path,
    epochs: float | None = None,
    minutes: float | None = None,
    lr: float | None = None,
    compute: Literal["float32", "bfloat16"] = "float32",
    device: Literal["cpu", "cuda"] = "cpu",
    max_views: int | None = None,
    cache: Path | None = None,
    seed: int = 133,
) -> None:
    """Train the paper's ablations and the other networks with one recipe and compare them in one table.

    Parameters
    ----------
    names
        Of full, no-height (PointNet++), pointnet, no-dropout, 512-points, 2048-points; default: all.
    data
        Training views, as for `train`.
    val
        Validation views.
    test
        Views to compare on.
    out
        Folder with one training per variant, ablation.md and ablation.json. Finished variants are not trained again.
    epochs
        Per variant.
    minutes
        Per variant, by the clock.
    lr
        First learning rate (1e-3).
    compute, device
        As for `train`.
    max_views
        Compare on the first so many.
    cache
        Folder of prepared clouds, shared by the variants; default: in --out.
    seed
        Of everything random.
    """
    import torch
    from rich.console import Console
    from rich.markdown import Markdown

    from regressor.studies.ablate import VARIANTS, markdown, read_table
    from regressor.studies.ablate import ablate as run
    from regressor.training.recipe import recipe_named
    from regressor.training.run import RunOptions
    from tuberline.cli.training_bar import TrainingBar

    torch.set_num_threads(1)
    given = {"epochs": epochs, "minutes": minutes, "lr": lr, "compute": compute, "device": device, "seed": seed}
    settings = recipe_named("tuberline", shear=None, **given)
    command = shlex.join(["tuberline", *sys.argv[1:]])
    options = RunOptions(data, val, out, "ablation", False, 2.0, 1e9, 2000, command, cache)
    with TrainingBar() as bar:
        run(
            names or tuple(VARIANTS),
            settings,
            options,
            test=test,
            max_views=max_views,
            on_step=lambda name, training: bar.step(training, name),
        )
    table, words = read_table(out)
    Console().print(Markdown(markdown(table, recipe=words)))
