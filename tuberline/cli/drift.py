"""`tuberline drift`: weights on views that drift from their training."""

from __future__ import annotations

import json as json_module
import sys
from collections.abc import Container, Iterable
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from conveyor.errors import InputError
from tuberline.cli.numbers import Many, Seed
from tuberline.cli.twin_told import tell_twin


def drift(
    *,
    data: Path,
    out: Path,
    also: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    weights: Path | None = None,
    max_views: Many | None = 600,
    seed: Seed = 0,
    json: bool = False,
) -> None:
    """Evaluate weights on views that drift from their training: belt height, noise, kinds of tuber, belt distance.

    Reports the error of a view and the bias of the total, which is what drift ruins.

    Parameters
    ----------
    data
        A folder of view packs that no training has seen, or a 3DPotatoTwin folder, of which its part `test` is read.
        Noise is added to depth images alone.
    out
        Folder of drift.json and drift.md.
    also
        Further packs as NAME=FOLDER, e.g. "belt at 0.60 m=packs/far" (`tuberline simulate-views --distances 0.60
        --camera d405-1280`).
    weights
        A .safetensors or the authors' .pth file; default: the shipped ones.
    max_views
        Of each shift, the first so many.
    seed
        Of the noise.
    json
        Print the figures as JSON on stdout.
    """
    from conveyor.files import check_room, whole_output
    from conveyor.threads import use_threads
    from regressor.studies.drift import SHIFTS, write_drift
    from regressor.studies.drift import drift as run
    from regressor.weigh.weigher import Weigher
    from tuberline.cli.markdown import print_markdown
    from tuberline.cli.progress import work_bar

    check_room(out, option="--out")
    use_threads(1)
    others = _others(also or [], SHIFTS)
    tell_twin(data, *others.values())
    with work_bar("weighing") as on_work:
        measured = run(
            data,
            others,
            Weigher.load(weights),
            max_views=max_views,
            seed=seed,
            on_work=on_work,
        )
    with whole_output(out) as partial:
        text = write_drift(measured, partial)
    if json:
        sys.stdout.write(json_module.dumps(measured, indent=1) + "\n")
    else:
        print_markdown(text)


def _others(also: Iterable[str], shifts: Container[str]) -> dict[str, Path]:
    """Further packs by their names.

    Raises:
        InputError: one without a name or a folder, or a name that stands in the table already.
    """
    found: dict[str, Path] = {}
    for text in also:
        name, _, folder = text.partition("=")
        if not name or not folder:
            raise InputError(f"--also {text}: every further pack is NAME=FOLDER")
        if name in found or name in shifts:
            raise InputError(f"--also {text}: the table has a row '{name}' already; give it another name")
        found[name] = Path(folder)
    return found
