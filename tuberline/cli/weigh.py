"""`tuberline weigh`: single clouds and depth images, without a line."""

from __future__ import annotations

import json as json_module
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from conveyor.errors import InputError
from conveyor.stated import BELT_SD_MM
from tuberline.cli.numbers import BeltDistance, RestingOffset, RestingSd, within
from tuberline.cli.progress import progress_bar
from tuberline.cli.stoppable import leave, stoppable
from tuberline.cli.twin_told import tell_trained_resting

if TYPE_CHECKING:
    from rich.progress import Progress

    from regressor.weigh.files import FileOptions, FileResult


def weigh(
    paths: Annotated[list[Path], Parameter(consume_multiple=True)],
    /,
    *,
    belt_distance_m: BeltDistance,
    belt_sd_mm: Annotated[float, within(*BELT_SD_MM, "mm")] = 2.0,
    resting_offset_mm: RestingOffset | None = None,
    resting_sd_mm: RestingSd = 0.0,
    instances: Path | None = None,
    weights: Path | None = None,
    depth_scale_m: Annotated[float | None, Parameter(name=["--depth-scale-m", "--depth-unit"])] = None,
    intrinsics: Path | None = None,
    json: bool = False,
    csv: bool = False,
) -> None:
    """Weigh single clouds (.ply, .npz, .npy, .pcd, .xyz, .las), depth and mask pairs (.png), or a frame's objects.

    Exits with 2 if any file could not be weighed; the others are weighed all the same, but none where a path is not
    there. Ctrl-C ends it with 130 and says how many were weighed; those are shown, but with --json or --csv nothing is.

    Parameters
    ----------
    paths
        Clouds in the camera's frame and metres, one tuber each; either file of a 3DPotatoTwin depth/rgb pair; folders
        of them; or, with --instances, one depth frame.
    belt_distance_m
        Camera to belt along the optical axis, metres.
    belt_sd_mm
        How well that distance is known, standard deviation in millimetres: it widens intervals, and up to 2.5 mm it
        moves weights a little.
    resting_offset_mm
        How far tubers' undersides lie below that distance, millimetres: between rods, on a belt that sags (0).
    resting_sd_mm
        How well that offset is known, standard deviation in millimetres.
    instances
        Image of the frame's size with the number of the object that each pixel belongs to, 0 for background: one row
        per object.
    weights
        A .safetensors or the authors' .pth file; default: the shipped ones.
    depth_scale_m
        Metres per unit of a depth image; default: what the intrinsics file says, else 0.001 (1 for decimal depth).
    intrinsics
        Intrinsics of a depth image (see `import`); default: 0_camera_intrinsics/ beside the images.
    json
        Print a JSON list on stdout.
    csv
        Print a table of comma-separated values on stdout.
    """
    if json and csv:
        raise InputError("give --json or --csv, not both")
    if instances is not None and (len(paths) != 1 or paths[0].is_dir()):
        given = f"{paths[0]} is a folder" if len(paths) == 1 else f"{len(paths)} paths are given"
        raise InputError(f"--instances belong to one frame, {given}: name one depth image")

    def weighed(done: list[FileResult], progress: Progress) -> None:
        from regressor.weigh.files import FileOptions

        options = FileOptions(
            belt_distance_m=belt_distance_m,
            belt_sd_m=belt_sd_mm / 1000,
            depth_scale_m=depth_scale_m,
            intrinsics=intrinsics,
            resting_offset_m=(resting_offset_mm or 0.0) / 1000,
            resting_sd_m=resting_sd_mm / 1000,
        )
        _weigh_all(paths, instances, options, weights, done, progress, told=resting_offset_mm is not None)

    _run(weighed, len(paths), "json" if json else "csv" if csv else "table")


def _run(weighed: Callable[[list[FileResult], Progress], None], count: int, form: str) -> None:
    """Weigh, until all is weighed or Ctrl-C, then show what was."""
    results: list[FileResult] = []
    bar = progress_bar(transient=True)
    task = bar.add_task("weighing", total=count)

    def how_far() -> str:
        told = f"stopped: {len(results)} of {bar.tasks[task].total:.0f} were weighed"
        return told + (", nothing was written" if form != "table" else "")

    with stoppable(how_far) as stopped, bar:
        weighed(results, bar)
    if stopped.is_set() and (form != "table" or not results):
        leave()
    if form != "table" or any(result.weighed for result in results):
        _show(results, form)
    if stopped.is_set():
        leave()
    failed = [result.error for result in results if result.error]
    if failed:
        raise InputError("\n".join(failed))


def _weigh_all(
    paths: list[Path],
    instances: Path | None,
    options: FileOptions,
    weights: Path | None,
    done: list[FileResult],
    progress: Progress,
    *,
    told: bool,
) -> None:
    """One result after the other, so that what was weighed counts when stopped. `told`: the resting offset was."""
    from conveyor.threads import use_threads
    from regressor.weigh.files import files_within, once_per_pair, weigh_file
    from regressor.weigh.instances import weigh_instances
    from regressor.weigh.weigher import Weigher

    use_threads(1)
    (task,) = progress.task_ids
    wanted = paths if instances else once_per_pair(files_within(paths))
    progress.update(task, total=len(wanted))
    weigher = Weigher.load(weights)
    if not told:
        tell_trained_resting(weigher.sidecar)
    if instances is not None:
        done.extend(weigh_instances(paths[0], instances, options, weigher))
        return
    for path in wanted:
        done.append(weigh_file(path, options, weigher))
        progress.update(task, completed=len(done))


def _show(results: list[FileResult], form: str) -> None:
    if form == "json":
        sys.stdout.write(json_module.dumps([result.as_dict() for result in results], indent=1) + "\n")
        return
    from tuberline.cli.weigh_table import weight_csv, weight_table

    if form == "csv":
        sys.stdout.write(weight_csv(results))
        return
    from rich.console import Console

    Console().print(weight_table(results))
