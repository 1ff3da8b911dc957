"""Every object of one depth frame, from an image that says which pixel belongs to which."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.camera_flags import CUT
from conveyor.errors import InputError
from conveyor.formats.plain.depth import DepthUnit
from conveyor.formats.plain.files import read_frames, read_labels
from conveyor.formats.plain.pinhole import read_pinhole
from conveyor.formats.potatotwin.intrinsics import find_intrinsics
from conveyor.geometry import Intrinsics, at_border, box_around, straight_down_belt_from_camera
from conveyor.islands import labels_apart
from regressor.weigh.files import FileOptions, FileResult
from regressor.weigh.place import distance_fault
from regressor.weigh.prepare import RefusedCloud, prepare_depth
from regressor.weigh.weigher import Weigher

APART = (
    "it lies in several places with bare belt between them, so it is several: give each object a number of its own "
    "(1, 2, 3, ..., not 255 to all)"
)


def weigh_instances(frame: Path, instances: Path, options: FileOptions, weigher: Weigher) -> Iterator[FileResult]:
    """One result per object, by its number.

    Args:
        frame: depth image of any kind that `tuberline import` reads. instances: (H, W) of the same size.

    Raises:
        InputError: frame, instances or intrinsics that cannot be used, or that do not fit each other.
    """
    depth, unit_m, intrinsics = _read(frame, options)
    labels = read_labels(instances)
    if labels.shape != depth.shape:
        raise InputError(
            f"instances {instances} are {labels.shape[1]}x{labels.shape[0]}, the frame {frame} is "
            f"{depth.shape[1]}x{depth.shape[0]}: they must have one size"
        )
    objects = [int(label) for label in np.unique(labels) if label]
    if not objects:
        raise InputError(f"instances {instances} mark no object: every pixel is 0")
    apart = labels_apart(labels, cell_mm=1000 * options.belt_distance_m / intrinsics.fx)
    for label in objects:
        if label in apart:
            yield FileResult(frame, 0, None, None, error=f"{frame}, object {label}: {APART}", object=label)
            continue
        yield _weigh(frame, label, labels == label, depth, unit_m, intrinsics, options, weigher)


def _read(frame: Path, options: FileOptions) -> tuple[NDArray[np.uint16], float, Intrinsics]:
    """(H, W) depth, metres per unit, intrinsics."""
    stack: NDArray[Any] = read_frames(frame)
    if len(stack) != 1:
        raise InputError(f"{frame} holds {len(stack)} frames; instances belong to one")
    pinhole = read_pinhole(options.intrinsics or find_intrinsics(frame))
    intrinsics = pinhole.intrinsics(stack.shape[2], stack.shape[1], where=options.intrinsics or frame)
    usual_m = 1.0 if stack.dtype.kind == "f" else 0.001
    unit = DepthUnit.of(
        options.depth_scale_m or pinhole.depth_scale_m or usual_m, stack[0], where=frame, option="--depth-scale-m"
    )
    return unit.convert(stack[0], where=frame), unit.stored_m, intrinsics


def _weigh(
    frame: Path,
    label: int,
    inside: NDArray[np.bool_],
    depth: NDArray[np.uint16],
    unit_m: float,
    k: Intrinsics,
    options: FileOptions,
    weigher: Weigher,
) -> FileResult:
    where = f"{frame}, object {label}"
    box = box_around(inside)
    rows, columns = box
    try:
        cloud = prepare_depth(
            np.where(inside, depth, 0)[box].astype(np.uint16),
            depth_scale_m=unit_m,
            fx=k.fx,
            fy=k.fy,
            cx=k.cx - columns.start,
            cy=k.cy - rows.start,
            belt_from_camera=straight_down_belt_from_camera(options.belt_distance_m),
            resting_offset_m=options.resting_offset_m,
        )
    except RefusedCloud as refusal:
        return FileResult(frame, 0, None, None, error=f"{where}: {refusal}", object=label)
    height_mm = round(cloud.height_m * 1e3, 2)
    fault = distance_fault(cloud)
    if fault:
        return FileResult(frame, len(cloud.points), height_mm, None, error=f"{where}: {fault}", object=label)
    weighed = weigher.weigh(cloud, belt_sd_m=options.belt_sd_m, resting_sd_m=options.resting_sd_m)
    if at_border(box, k):
        weighed = replace(weighed, flags=(*weighed.flags, CUT))
    return FileResult(frame, len(cloud.points), height_mm, weighed, object=label)
