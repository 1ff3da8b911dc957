"""`tuberline weigh`: single clouds and depth images, without a line."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from conveyor.errors import InputError
from tuberline.cli.stoppable import leave, stoppable

if TYPE_CHECKING:
    from regressor.weigh.files import FileResult


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

    Exits with 2 if any file could not be weighed; the others are weighed all the same. Ctrl-C ends it with 130 and says
    how many were weighed; those are shown, but with --json nothing is.

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
    if not 0.05 <= belt_distance_m <= 5.0:
        raise InputError(f"--belt-distance-m is {belt_distance_m}; allowed are 0.05 to 5 metres (the paper: 0.345)")
    if not 0 <= belt_sd_mm <= 100:
        raise InputError(
            f"--belt-sd-mm is {belt_sd_mm}; allowed are 0 to 100 millimetres (a calibrated belt: 0.5 to 2)"
        )
    check_resting(resting_offset_mm, resting_sd_mm)
    results: list[FileResult] = []
    wanted = list(paths)

    def how_far() -> str:
        return f"stopped: {len(results)} of {len(wanted)} were weighed" + (", nothing was written" if json else "")

    with stoppable(how_far) as stopped:
        import torch

        from regressor.weigh.files import FileOptions, once_per_pair, weigh_file
        from regressor.weigh.weigher import Weigher

        torch.set_num_threads(1)
        options = FileOptions(
            belt_distance_m=belt_distance_m,
            belt_sd_m=belt_sd_mm / 1000,
            depth_scale_m=depth_scale_m,
            intrinsics=intrinsics,
            resting_offset_m=resting_offset_mm / 1000,
            resting_sd_m=resting_sd_mm / 1000,
        )
        wanted = once_per_pair(paths)
        weigher = Weigher.load(weights)
        for path in wanted:
            results.append(weigh_file(path, options, weigher))  # noqa: PERF401 - what was weighed counts when stopped
    if stopped.is_set() and (json or not results):
        leave()
    if json:
        sys.stdout.write(json_module.dumps([result.as_dict() for result in results], indent=1) + "\n")
    else:
        from rich.console import Console

        from tuberline.cli.weigh_table import weight_table

        Console().print(weight_table(results))
    if stopped.is_set():
        leave()
    failed = [result.error for result in results if result.error]
    if failed:
        raise InputError("\n".join(failed))


def check_resting(offset_mm: float, sd_mm: float) -> None:
    """Refuse a resting level that no belt has.

    Raises:
        InputError: with the option, the value and what is allowed.
    """
    if not -20 <= offset_mm <= 40:
        raise InputError(f"--resting-offset-mm is {offset_mm:g}; allowed are -20 to 40 mm, positive below the belt")
    if not 0 <= sd_mm <= 20:
        raise InputError(f"--resting-sd-mm is {sd_mm:g}; allowed are 0 to 20 mm")
