"""The plain folder recording: its files and the checks on them (docs/formats.md)."""

from __future__ import annotations

import csv
import itertools
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from conveyor.errors import InputError
from conveyor.formats.source import CameraDescription
from conveyor.geometry import Intrinsics
from conveyor.pose import pose_fault
from conveyor.ranges import FASTEST_MPS, INT64_MAX, MAX_COUNT
from conveyor.refused import in_words
from conveyor.text_files import read_json

COLUMNS = ["seq", "captured_ns", "travel_m"]


class CameraFile(BaseModel):
    """camera.json; null is as good as no key."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    name: str
    width: int = Field(gt=0, le=16384)
    height: int = Field(gt=0, le=16384)
    fx: float = Field(gt=0)
    fy: float = Field(gt=0)
    cx: float
    cy: float
    depth_scale_m: float = Field(gt=0, le=0.01)
    belt_distance_m: float | None = Field(None, gt=0, le=10)
    belt_from_camera: list[list[float]] | None = None
    fps: float = Field(30.0, gt=0, le=1000)
    resting_offset_mm: float | None = Field(None, ge=-20, le=40)
    resting_sd_mm: float | None = Field(None, ge=0, le=20)

    @model_validator(mode="before")
    @classmethod
    def _without_nulls(cls, told: Any) -> Any:
        return {key: value for key, value in told.items() if value is not None} if isinstance(told, dict) else told

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_value(cls, value: Any) -> Any:
        """True would be read as 1."""
        if isinstance(value, bool):
            raise ValueError("true and false are no numbers")
        return value

    @field_validator("belt_from_camera", mode="before")
    @classmethod
    def _rows(cls, value: Any) -> Any:
        """16 numbers in one list are the rows of the matrix one after the other."""
        flat = isinstance(value, list) and len(value) == 16 and not any(isinstance(item, list) for item in value)
        return [value[at : at + 4] for at in range(0, 16, 4)] if flat else value


@dataclass(frozen=True, slots=True)
class FrameRow:
    """One line of frames.csv."""

    seq: int
    captured_ns: int
    travel_m: float | None


SET_BACK_M, SET_BACK_STEPS, SET_BACK_LEAST_M = 0.25, 3.0, 0.03
"""Between two frames no belt runs back that far, nor so many of its usual steps (and that far): its counter was set
back."""
JUMP_STEPS = 5.0
"""Travel that is faster than a belt, by more than so many usual steps, jumped."""
MOST_JUMPS = 0.1
"""Of all steps. Where more of them jump, travel is no metres: that is another fault, told elsewhere."""


def read_camera_file(path: Path) -> CameraFile:
    """camera.json at `path`.

    Raises:
        InputError: missing, not JSON, or without what it takes to read depth; names every fault.
    """
    try:
        camera = CameraFile.model_validate(read_json(path))
    except ValidationError as error:
        raise InputError(f"{path} cannot be used:\n{_faults(error)}") from error
    fault = None if camera.belt_from_camera is None else pose_fault(camera.belt_from_camera)
    if fault:
        raise InputError(f"{path}: {fault}")
    return camera


_NEEDED = [name for name, field in CameraFile.model_fields.items() if field.is_required()]


def _faults(error: ValidationError) -> str:
    lines = []
    for fault in error.errors():
        where = ".".join(str(part) for part in fault["loc"]) or "the file"
        if fault["type"] == "missing":
            lines.append(f"  {where}: missing; needed are {', '.join(_NEEDED)} (pixels, from the camera's calibration)")
        else:
            lines.append(f"  {where}: {in_words(fault)} (got {fault.get('input')!r})")
    return "\n".join(lines)


def describe(camera: CameraFile, *, origin: str, frames: int | None) -> CameraDescription:
    """The description of a recorded camera."""
    return CameraDescription(
        name=camera.name,
        origin=origin,
        intrinsics=Intrinsics(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy),
        depth_scale_m=camera.depth_scale_m,
        belt_distance_m=camera.belt_distance_m,
        belt_from_camera=None if camera.belt_from_camera is None else np.asarray(camera.belt_from_camera, float),
        fps=camera.fps,
        frames=frames,
        resting_offset_mm=camera.resting_offset_mm,
        resting_sd_mm=camera.resting_sd_mm,
    )


def camera_json(description: CameraDescription) -> dict[str, Any]:
    """camera.json of a description; what is not known of the resting level is left out."""
    k = description.intrinsics
    matrix = description.belt_from_camera
    resting = {"resting_offset_mm": description.resting_offset_mm, "resting_sd_mm": description.resting_sd_mm}
    return {
        "name": description.name,
        "width": k.width,
        "height": k.height,
        "fx": k.fx,
        "fy": k.fy,
        "cx": k.cx,
        "cy": k.cy,
        "depth_scale_m": description.depth_scale_m,
        "belt_distance_m": description.belt_distance_m,
        "belt_from_camera": None if matrix is None else matrix.tolist(),
        "fps": description.fps,
        **{key: value for key, value in resting.items() if value is not None},
    }


def read_frame_rows(path: Path) -> list[FrameRow]:
    """All rows of frames.csv.

    Raises:
        InputError: missing, or a line that cannot be used; the text has its number.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = list(csv.reader(file))
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} is not CSV text: {error}") from error
    if not lines or [cell.strip() for cell in lines[0]] != COLUMNS:
        raise InputError(f"{path} line 1: the header must be '{','.join(COLUMNS)}', got {lines[0] if lines else ''}")
    numbered = [
        (number, _row(path, number, cells))
        for number, cells in enumerate(lines[1:], start=2)
        if any(cell.strip() for cell in cells)
    ]
    if not numbered:
        raise InputError(f"{path} names no frames")
    if fault := _order_fault(numbered):
        raise InputError(f"{path} {fault}")
    return [row for _, row in numbered]


def _order_fault(numbered: list[tuple[int, FrameRow]]) -> str:
    """Where seq does not rise from line to line, in words, and what to do about it; empty where it does. Nothing is
    sorted here: either the rows are out of order, or the numbers are, and these name the frames' files.
    """
    pairs = itertools.pairwise(numbered)
    fallen = next(((before, at) for before, at in pairs if at[1].seq <= before[1].seq), None)
    if fallen is None:
        return ""
    (_, before), (number, row) = fallen
    where = f"line {number}: seq {row.seq} after {before.seq}; numbers must rise"
    count = Counter(row.seq for _, row in numbered)
    if double := [seq for seq, n in count.items() if n > 1]:
        lines = [str(number) for number, row in numbered if row.seq == double[0]]
        more = f", and {len(double) - 1} other numbers several times" if len(double) > 1 else ""
        return (
            f"{where}. Lines {' and '.join(lines[:5])} have seq {double[0]}{more}: remove the rows that are too many; "
            "or, where the camera began to count again, number the later rows on, and their files "
            f"(depth/{double[0]:06d}.png)"
        )
    if _rise([row for _, row in sorted(numbered, key=lambda at: at[1].seq)]):
        return f"{where}: sort the rows by seq, the header stays the first line"
    return (
        f"{where}. Sorted by seq, captured_ns would fall: number the frames in the order of captured_ns, rows and "
        "files (depth/, mask/, color/) alike"
    )


def _rise(rows: list[FrameRow]) -> bool:
    """Capture times never fall from row to row."""
    return all(row.captured_ns <= later.captured_ns for row, later in itertools.pairwise(rows))


@dataclass(frozen=True, slots=True)
class GoingOn:
    """Rows whose belt travel goes on, and the numbers of the frames where it was set back, or jumped."""

    rows: list[FrameRow]
    set_back: list[int]
    jumped: list[int]


def travel_going_on(rows: list[FrameRow]) -> GoingOn:
    """The rows with belt travel that goes on where it was set back or jumped.

    A counter that starts again puts other tubers where the first ones lay, and they would be taken for the same; one
    that jumps tears a tuber apart that lies in view. What the belt moved meanwhile is taken from its median speed, by
    the clock, or by frame numbers where that fell back too.
    """
    given = [n for n, row in enumerate(rows) if row.travel_m is not None]
    travel_m = np.array([rows[n].travel_m for n in given], float)
    frames = np.diff([rows[n].seq for n in given])
    ns = np.diff([rows[n].captured_ns for n in given])
    moved_m = np.diff(travel_m)
    forward = moved_m > 0
    step_m = float(np.median(moved_m[forward] / frames[forward])) if forward.any() else 0.0
    back_m = min(SET_BACK_M, max(SET_BACK_LEAST_M, SET_BACK_STEPS * step_m))
    set_back = moved_m < -back_m * frames
    jumped = (ns > 0) & (moved_m > FASTEST_MPS * ns / 1e9 + JUMP_STEPS * step_m * frames)
    if jumped.sum() > MOST_JUMPS * len(moved_m):
        jumped[:] = False
    if not (set_back | jumped).any():
        return GoingOn(rows, [], [])
    unknown = set_back | jumped | _silent(moved_m, set_back, jumped)
    usual = forward & ~jumped & (ns > 0)
    by_clock_m = ns * np.median(moved_m[usual] / ns[usual]) if usual.any() else 0.0 * frames
    by_number_m = frames * np.median(moved_m[usual] / frames[usual]) if usual.any() else 0.0 * frames
    steps_m = np.where(unknown, np.where(ns > 0, by_clock_m, by_number_m), moved_m)
    going_on = list(rows)
    for n, at_m in zip(given[1:], travel_m[0] + np.cumsum(steps_m), strict=True):
        going_on[n] = replace(rows[n], travel_m=float(at_m))
    found = [[rows[n].seq for n, is_so in zip(given[1:], where, strict=True) if is_so] for where in (set_back, jumped)]
    return GoingOn(going_on, *found)


def _silent(moved_m: NDArray[np.float64], set_back: NDArray[np.bool_], jumped: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,) steps between a fall and the jump that undid it, all of them zero: the encoder said nothing meanwhile."""
    silent = np.zeros(len(moved_m), np.bool_)
    for n in np.flatnonzero(set_back):
        moving = np.flatnonzero(moved_m[n + 1 :])
        if len(moving) and jumped[n + 1 + moving[0]]:
            silent[n + 1 : n + 1 + moving[0]] = True
    return silent


def _row(path: Path, number: int, cells: list[str]) -> FrameRow:
    if len(cells) != len(COLUMNS):
        raise InputError(f"{path} line {number}: {len(COLUMNS)} values ({','.join(COLUMNS)}) are needed, got {cells}")
    try:
        seq, captured_ns = int(cells[0]), int(cells[1])
        travel_m = float(cells[2]) if cells[2].strip() else None
    except ValueError as error:
        raise InputError(
            f"{path} line {number}: seq and captured_ns (nanoseconds) are whole numbers and travel_m metres or empty, "
            f"got {cells}"
        ) from error
    if not (0 <= seq <= MAX_COUNT and 0 <= captured_ns <= INT64_MAX and (travel_m is None or abs(travel_m) <= 1e7)):
        raise InputError(
            f"{path} line {number}: seq must be 0 to {MAX_COUNT}, captured_ns 0 to {INT64_MAX} and travel_m empty or "
            f"finite and within 10,000 km, got {cells}"
        )
    return FrameRow(seq, captured_ns, travel_m)
