"""`tuberline ablate`: the paper's ablations."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Literal

from tuberline.cli.numbers import Many, Seed
from tuberline.cli.twin_told import tell_parts_left_out, tell_twin


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
    max_views: Many | None = None,
    cache: Path | None = None,
    seed: Seed = 133,
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
        Views to compare on; of a 3DPotatoTwin folder its part `test`.
    out
        Folder with one training per variant, ablation.md and ablation.json. Finished variants are not trained
        again; they must be of the same options.
    epochs
        Per variant.
    minutes
        Per variant, by the clock.
    lr
        First learning rate (1e-3).
    compute
        As for `train`.
    device
        As for `train`.
    max_views
        Compare on the first so many.
    cache
        Folder of prepared clouds, shared by the variants; default: in --out.
    seed
        Of everything random.
    """
    import torch

    from regressor.studies.ablate import VARIANTS, markdown, read_table
    from regressor.studies.ablate import ablate as run
    from regressor.training.beginning import gone_where_refused
    from regressor.training.recipe import recipe_named
    from regressor.training.run import RunOptions
    from tuberline.cli.markdown import print_markdown
    from tuberline.cli.training_bar import TrainingBar

    tell_twin(data, val, test)
    torch.set_num_threads(1)
    given = {"epochs": epochs, "minutes": minutes, "lr": lr, "compute": compute, "device": device, "seed": seed}
    settings = recipe_named("tuberline", shear=None, **given)
    command = shlex.join(["tuberline", *sys.argv[1:]])
    options = RunOptions(data, val, out, "ablation", False, 2.0, 1e9, 2000, command, cache)
    left_out: dict[str, str] = {}
    with gone_where_refused(out), TrainingBar() as bar:
        run(
            names or tuple(VARIANTS),
            settings,
            options,
            test=test,
            max_views=max_views,
            on_step=lambda name, training: bar.step(training, name),
            on_left_out=left_out.__setitem__,
        )
    tell_parts_left_out(left_out)
    table, words = read_table(out)
    print_markdown(markdown(table, recipe=words))
