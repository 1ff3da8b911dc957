"""`tuberline simulate-line-views`: views as a line cuts them, for training and evaluation."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Literal

from conveyor.errors import InputError
from tuberline.cli.numbers import Many, Seed
from tuberline.cli.simulate_views import check_distances, former_views, remove


def simulate_line_views(
    *,
    out: Path,
    recordings: Many = 40,
    seed: Seed = 1,
    preset: Literal["field", "easy", "harsh", "worlds", "exact", "matched"] = "worlds",
    distances: tuple[float, ...] = (),
    force: bool = False,
) -> None:
    """Make views of simulated tubers as a line cuts them: its segmenter runs over whole recordings of 25 tubers.

    Parameters
    ----------
    out
        Folder to write a view pack to.
    recordings
        How many recordings. Each has its own camera, belt, speed and density of load.
    seed
        The same seed gives the same views.
    preset
        How hard, as in `simulate-views`; worlds: easy, field or harsh, drawn by recording.
    distances
        Belt distances in metres to choose from; any from 0.30 to 0.55 m where none are given.
    force
        Overwrite views that are there.
    """
    from conveyor.files import whole_output
    from tuberline.cli.progress import progress_bar
    from tuberline.line_views import LineViewPlan, write_line_views

    if recordings < 1:
        raise InputError(f"--recordings {recordings}: at least 1 is needed")
    check_distances(distances, needed=False)
    former = former_views(out, force=force)
    with whole_output(out) as partial, progress_bar() as progress:
        task = progress.add_task("recordings", total=recordings)
        views, tubers = write_line_views(
            partial,
            LineViewPlan(seed, preset, distances),
            recordings=recordings,
            command=" ".join(["tuberline", *sys.argv[1:]]),
            on_recording=lambda _: progress.advance(task),
        )
        remove(former)
    sys.stdout.write(f"{views} views of {tubers} tubers in {out}\n")
