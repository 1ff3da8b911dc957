"""The regressor's commands: its process, weighing files, training, evaluation, import and export of checkpoints."""

from __future__ import annotations

import json as json_module
import shlex
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter


def regressor(*, config: Path, name: str, run: str) -> None:
    """Weigh views; any number of regressors, anywhere.

    Parameters
    ----------
    config
        The line's TOML file.
    name
        This worker's name, unique on the line.
    run
        Id of this run.
    """
    from conveyor.config import load_config
    from regressor.serve.node import run_regressor

    run_regressor(load_config(config), name=name, run=run)


def weigh(
    paths: Annotated[list[Path], Parameter(consume_multiple=True)],
    /,
    *,
    belt_distance_m: float,
    belt_sd_mm: float = 2.0,
    resting_offset_mm: float = 0.0,
    resting_sd_mm: float = 0.0,
    weights: Path | None = None,
    depth_scale_m: float | None = None,
    intrinsics: Path | None = None,
    json: bool = False,
) -> None:
    """Weigh single clouds (.ply, .npz, .npy) or depth and mask pairs (.png) of one tuber each.

    Exits with 2 if any file could not be weighed; the others are weighed all the same.

    Parameters
    ----------
    paths
        Clouds in the camera's frame and metres, or either file of a 3DPotatoTwin depth/rgb pair.
    belt_distance_m
        Camera to belt along the optical axis, metres.
    belt_sd_mm
        How well that distance is known, standard deviation in millimetres: it widens the intervals.
    resting_offset_mm
        How far tubers' undersides lie below that distance, millimetres: between rods, on a belt that sags.
    resting_sd_mm
        How well that offset is known, standard deviation in millimetres.
    weights
        A .safetensors or an upstream .pth file; default: the shipped ones.
    depth_scale_m
        Metres per unit of a depth image; default: what the intrinsics file says, else 0.001.
    intrinsics
        Intrinsics of a depth image; default: 0_camera_intrinsics/ beside the images.
    json
        Print a JSON list on stdout.
    """
    import torch

    from conveyor.errors import InputError
    from regressor.weigh.files import FileOptions, weigh_files
    from regressor.weigh.weigher import Weigher

    if not 0.05 <= belt_distance_m <= 5.0:
        raise InputError(f"--belt-distance-m is {belt_distance_m}; allowed are 0.05 to 5 metres (the paper: 0.345)")
    if not 0 <= belt_sd_mm <= 100:
        raise InputError(
            f"--belt-sd-mm is {belt_sd_mm}; allowed are 0 to 100 millimetres (a calibrated belt: 0.5 to 2)"
        )
    if not -20 <= resting_offset_mm <= 40:
        raise InputError(
            f"--resting-offset-mm is {resting_offset_mm}; allowed are -20 to 40 millimetres, positive below the belt"
        )
    if not 0 <= resting_sd_mm <= 20:
        raise InputError(f"--resting-sd-mm is {resting_sd_mm}; allowed are 0 to 20 millimetres")
    torch.set_num_threads(1)
    options = FileOptions(
        belt_distance_m=belt_distance_m,
        belt_sd_m=belt_sd_mm / 1000,
        depth_scale_m=depth_scale_m,
        intrinsics=intrinsics,
        resting_offset_m=resting_offset_mm / 1000,
        resting_sd_m=resting_sd_mm / 1000,
    )
    results = weigh_files(paths, options, Weigher.load(weights))
    if json:
        sys.stdout.write(json_module.dumps([result.as_dict() for result in results], indent=1) + "\n")
    else:
        from rich.console import Console

        from tuberline.cli.weigh_table import weight_table

        Console().print(weight_table(results))
    failed = [result.error for result in results if result.error]
    if failed:
        raise InputError("\n".join(failed))


def train(
    *,
    data: Path,
    val: Path,
    out: Path,
    recipe: Literal["tuberline", "paper", "fine-tune"] = "tuberline",
    start: Path | None = None,
    epochs: float | None = None,
    minutes: float | None = None,
    resume: bool = False,
    batch: int | None = None,
    lr: float | None = None,
    weight_decay: float | None = None,
    dropout: float | None = None,
    height_embedding: bool = True,
    shear: float | None = None,
    balanced: bool | None = None,
    compute: Literal["float32", "bfloat16"] = "float32",
    device: Literal["cpu", "cuda"] = "cpu",
    threads: int = 1,
    seed: int = 133,
    save_minutes: float = 2.0,
    validate_minutes: float = 5.0,
    max_validation_views: int = 2000,
    name: str = "pointraft",
    target: Literal["weight_g", "volume_ml", "length_mm"] = "weight_g",
) -> None:
    """Train PointRAFT; writes weights.safetensors with its sidecar, log.csv and a state to resume from.

    Parameters
    ----------
    data
        A folder of view packs (`tuberline simulate-views`) or a 3DPotatoTwin folder.
    val
        The same for validation. The same folder means the splits of its splits.csv.
    out
        Folder to write into.
    recipe
        Defaults of everything below: ours, the paper's, or ours for going on from trained weights.
    start
        Weights to begin with (.safetensors), for the recipe fine-tune; default: random ones.
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
    import torch

    from conveyor.errors import InputError
    from regressor.training.recipe import recipe_named
    from regressor.training.run import RunOptions
    from regressor.training.run import train as run
    from tuberline.cli.training_bar import TrainingBar

    if (recipe == "fine-tune") != (start is not None):
        raise InputError("--recipe fine-tune and --start WEIGHTS belong together: give both or neither")
    torch.set_num_threads(threads)
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
    )
    options = RunOptions(
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
    with TrainingBar() as bar:
        sidecar = run(options, settings, on_prepared=bar.prepared, on_step=bar.step, on_validated=bar.validated)
    figures = sidecar.metrics["validation"]
    sys.stderr.write(f"{out / 'weights.safetensors'}: MAE {figures['mae_g']:.1f} g per view on the validation set\n")


def import_checkpoint(
    path: Path, /, *, out: Path, name: str | None = None, start: Literal["random", "prefix"] = "random", seed: int = 0
) -> None:
    """Take over the authors' checkpoint (pointraft_potato.pth) as .safetensors with a sidecar.

    Parameters
    ----------
    path
        The .pth file.
    out
        The .safetensors file to write; its sidecar goes beside it.
    name
        Of the weights, as it will stand in ledgers; default: the file's name.
    start
        Where sampling starts. The authors' network was trained with random starts: keep 'random' for it.
    seed
        Of the random starts.
    """
    from conveyor.errors import InputError
    from regressor.network.checkpoint import StartPolicy, load_checkpoint, save_checkpoint

    if out.suffix != ".safetensors":
        raise InputError(f"--out {out} must end in .safetensors")
    model, sidecar = load_checkpoint(path)
    changes = {"name": name or sidecar.name, "start": StartPolicy(kind=start, seed=seed)}
    written = save_checkpoint(out, model.state_dict(), sidecar.model_copy(update=changes))
    sys.stderr.write(f"{out}: {written.model_id}, {len(model.state_dict())} entries, start policy '{start}'\n")


def evaluate(
    *,
    data: Path,
    out: Path,
    weights: Path | None = None,
    split: str | None = None,
    season: str | None = None,
    max_views: int | None = None,
    by: tuple[str, ...] = (),
    resting: Literal["calibrated", "stated"] = "calibrated",
    plots: bool = True,
    json: bool = False,
) -> None:
    """Evaluate weights and baselines on views with known weights: tables, plots, per view and per tuber.

    Parameters
    ----------
    data
        A folder of view packs (`tuberline simulate-views`) or a 3DPotatoTwin folder.
    out
        Folder for report.md, metrics.json, metrics.csv, views.csv and errors.png.
    weights
        A .safetensors or an upstream .pth file; default: the shipped ones.
    split
        Of a 3DPotatoTwin folder's splits.csv.
    season
        Only tubers of this season; the baselines are fitted to them alone.
    max_views
        Only the first so many.
    by
        Classes for a table of bias by class and preset, with its 90 % interval over recordings (worlds.md): of pose,
        rim, weight, season, "belt distance", surface, calibrated; `all` for all of them.
    resting
        Of simulated views: the resting level as a calibration finds it, or as their user states it, known or not.
    plots
        Draw errors.png (needs the extra 'train').
    json
        Print the summary as JSON on stdout.
    """
    import importlib.util

    import torch
    from rich.console import Console
    from rich.markdown import Markdown
    from rich.progress import Progress, TextColumn

    from conveyor.errors import InputError
    from regressor.studies.evaluate import evaluate as run
    from regressor.studies.report import markdown, write_plots, write_report
    from regressor.studies.worlds import BY, by_class, by_preset
    from regressor.studies.worlds import markdown as worlds_table
    from regressor.weigh.weigher import Weigher

    unknown = sorted(set(by) - {*BY, "calibrated", "all"})
    if unknown:
        raise InputError(f"--by {unknown[0]}: known are {', '.join(BY)}, calibrated, all")
    if plots and importlib.util.find_spec("matplotlib") is None:
        raise InputError("plots need matplotlib: install the extra 'train', or give --no-plots")
    torch.set_num_threads(1)
    console = Console(stderr=True)
    with Progress(TextColumn("{task.description}"), console=console) as bar:
        task = bar.add_task("reading views")
        result = run(
            data,
            Weigher.load(weights, any_target=True),
            split=split,
            season=season,
            max_views=max_views,
            resting=resting,
            progress=lambda done: bar.update(task, description=f"{done} views weighed"),
        )
    title = f"Evaluation on {data.name}" + (f", season {season}" if season else "")
    measured = write_report(result, out, title=title)
    if plots:
        write_plots(result, out)
    worlds = ""
    if by:
        rows = by_preset(result), by_class(result, BY if "all" in by else by)
        worlds = worlds_table(*rows)
        measured = {**measured, "presets": [asdict(r) for r in rows[0]], "classes": [asdict(r) for r in rows[1]]}
        (out / "worlds.md").write_text(worlds, encoding="utf-8")
        (out / "metrics.json").write_text(json_module.dumps(measured, indent=1) + "\n", encoding="utf-8")
    if json:
        sys.stdout.write(json_module.dumps(measured, indent=1) + "\n")
    else:
        Console().print(Markdown(markdown(measured, title=title) + ("\n## By world\n\n" + worlds if by else "")))


def export(*, out: Path, weights: Path | None = None, batch: int | None = None) -> None:
    """Export weights to ONNX, with their sidecar beside them.

    Parameters
    ----------
    out
        The .onnx file to write.
    weights
        A .safetensors or an upstream .pth file; default: the shipped ones.
    batch
        Fix the batch size; default: any.
    """
    from conveyor.errors import InputError
    from regressor.network.checkpoint import load_checkpoint
    from regressor.network.export import export_onnx

    if out.suffix != ".onnx":
        raise InputError(f"--out {out} must end in .onnx")
    model, sidecar = load_checkpoint(weights)
    export_onnx(out, model, sidecar, batch=batch)
    sys.stderr.write(f"{out}: {sidecar.model_id}, batch {batch or 'open'}\n")
