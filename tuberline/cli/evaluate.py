"""`tuberline evaluate`: weights and baselines on views with known weights."""

from __future__ import annotations

import json as json_module
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from conveyor.errors import InputError
from tuberline.cli.numbers import Many
from tuberline.cli.twin_told import tell_twin


def evaluate(
    *,
    data: Path,
    out: Path,
    weights: Path | None = None,
    split: str | None = None,
    season: str | None = None,
    max_views: Many | None = None,
    by: tuple[str, ...] = (),
    resting: Literal["calibrated", "stated"] = "calibrated",
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
        A .safetensors or the authors' .pth file; default: the shipped ones.
    split
        Of a 3DPotatoTwin folder's splits.csv; default: all parts, the one of a training too.
    season
        Only tubers of this season; the baselines are fitted to them alone.
    max_views
        Only the first so many.
    by
        Classes for a table of bias by class and preset, with its 90 % interval over recordings (worlds.md): of pose,
        rim, weight, season, "belt distance", surface, soil, calibrated; `all` for all of them.
    resting
        Of simulated views: the resting level as a calibration finds it, or as their user states it, known or not.
    plots
        Draw errors.png (needs the extra 'train').
    json
        Print the summary as JSON on stdout.
    """
    import importlib.util

    from conveyor.files import check_room, whole_output
    from conveyor.threads import use_threads
    from regressor.studies.evaluate import evaluate as run
    from regressor.studies.report import markdown, write_plots, write_report
    from regressor.studies.worlds import BY, by_class, by_preset
    from regressor.studies.worlds import markdown as worlds_table
    from regressor.training.labelled import count_labelled, part_of
    from regressor.weigh.weigher import Weigher
    from tuberline.cli.markdown import print_markdown
    from tuberline.cli.progress import work_bar

    if plots and importlib.util.find_spec("matplotlib") is None:
        raise InputError("plots need matplotlib: install the extra 'train', or give --no-plots")
    unknown = sorted(set(by) - {*BY, "calibrated", "all"})
    if unknown:
        raise InputError(f"--by {unknown[0]}: known are {', '.join(BY)}, calibrated, all")
    check_room(out, option="--out")
    use_threads(1)
    if split is None and part_of(data, "test") is not None:
        sys.stderr.write(f"{data} has a splits.csv: all its parts are judged; --split test takes the test part alone\n")
    tell_twin(data)
    known = None if season else min(count_labelled(data, split=split), max_views or sys.maxsize)
    with work_bar("reading views") as on_work:
        result = run(
            data,
            Weigher.load(weights, any_target=True),
            split=split,
            season=season,
            max_views=max_views,
            resting=resting,
            progress=lambda done: on_work(f"{done} views weighed", done, known),
        )
    title = f"Evaluation on {data.name}" + (f", season {season}" if season else "")
    with whole_output(out) as partial:
        measured = write_report(result, partial, title=title)
        worlds = ""
        if by:
            rows = by_preset(result), by_class(result, BY if "all" in by else by)
            worlds = worlds_table(*rows)
            measured = {**measured, "presets": [asdict(r) for r in rows[0]], "classes": [asdict(r) for r in rows[1]]}
            (partial / "worlds.md").write_text(worlds, encoding="utf-8")
            (partial / "metrics.json").write_text(json_module.dumps(measured, indent=1) + "\n", encoding="utf-8")
        if plots:
            write_plots(result, partial)
    if json:
        sys.stdout.write(json_module.dumps(measured, indent=1) + "\n")
    else:
        print_markdown(markdown(measured, title=title) + ("\n## By world\n\n" + worlds if by else ""))
