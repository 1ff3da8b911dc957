"""`tuberline evaluate`: weights and baselines on views with known weights."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from conveyor.errors import InputError


def evaluate(
    *,
    data: Path,
    out: Path,
    weights: Path | None = None,
    split: str | None = None,
    season: str | None = None,
    max_views: int | None = None,
    plots: Annotated[bool, Parameter(negative="--no-plots")] = True,
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
    plots
        Draw errors.png (needs the extra 'train').
    json
        Print the summary as JSON on stdout.
    """
    import importlib.util

    import torch
    from rich.console import Console
    from rich.markdown import Markdown

    from conveyor.files import whole_output
    from regressor.studies.evaluate import evaluate as run
    from regressor.studies.report import markdown, write_plots, write_report
    from regressor.weigh.weigher import Weigher
    from tuberline.cli.progress import progress_bar

    if plots and importlib.util.find_spec("matplotlib") is None:
        raise InputError("plots need matplotlib: install the extra 'train', or give --no-plots")
    torch.set_num_threads(1)
    with progress_bar(total_known=False) as bar:
        task = bar.add_task("reading views")
        result = run(
            data,
            Weigher.load(weights, any_target=True),
            split=split,
            season=season,
            max_views=max_views,
            progress=lambda done: bar.update(task, description=f"{done} views weighed"),
        )
    title = f"Evaluation on {data.name}" + (f", season {season}" if season else "")
    with whole_output(out) as partial:
        measured = write_report(result, partial, title=title)
        if plots:
            write_plots(result, partial)
    if json:
        sys.stdout.write(json_module.dumps(measured, indent=1) + "\n")
    else:
        Console().print(Markdown(markdown(measured, title=title)))
