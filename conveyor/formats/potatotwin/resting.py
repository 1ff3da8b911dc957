"""How far below the belt the tubers of a folder in the layout of 3DPotatoTwin lie, and who says so.

The data set itself does not say; it was measured on one of its tubers (`conveyor.resting.POTATOTWIN`). A simulated
folder, and a crop whose table says where its camera hung, are not that data set: their tubers lie on the belt. Columns
`resting_offset_mm` and `resting_sd_mm` of ground_truth.csv state another level, one for the folder.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Literal

from conveyor.errors import InputError
from conveyor.formats.potatotwin.layout import INTRINSICS, RGBD, TRUTH, is_potatotwin, table_reader
from conveyor.resting import POTATOTWIN, RestingLevel
from conveyor.stated import RESTING_OFFSET_MM, RESTING_SD_MM

OFFSET, SD = "resting_offset_mm", "resting_sd_mm"
Source = Literal["stated", "measured", "belt"]
"""Who says it: the folder's table, the measurement on R9-9 of 3DPotatoTwin, or no one, so that it is the belt."""


def twin_resting(folder: Path) -> RestingLevel:
    """The resting level of a folder.

    Raises:
        InputError: a column of it holds no number of millimetres that is allowed, or several.
    """
    return level_of(folder)[0]


def level_of(folder: Path) -> tuple[RestingLevel, Source]:
    """The resting level of a folder, and who says it.

    Raises:
        InputError: as `twin_resting`.
    """
    table = folder / TRUTH
    if not table.is_file():
        return RestingLevel(), "belt"
    columns, told = _read(table)
    if OFFSET in columns or SD in columns:
        offset_mm = _stated(table, OFFSET, [offset for offset, _ in told], RESTING_OFFSET_MM)
        sd_mm = _stated(table, SD, [sd for _, sd in told], RESTING_SD_MM)
        return RestingLevel(offset_m=offset_mm / 1000, sd_m=sd_mm / 1000), "stated"
    simulated = folder / RGBD / INTRINSICS / "simulated_camera_intrinsic.json"
    own = simulated.is_file() or "belt_distance_m" in columns
    return (RestingLevel(), "belt") if own else (POTATOTWIN, "measured")


def _read(table: Path) -> tuple[list[str], list[tuple[str, str]]]:
    """(names of the columns, both texts of each row)."""
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            rows = table_reader(file)
            told = [(row.get(OFFSET) or "", row.get(SD) or "") for row in rows]
            return list(rows.fieldnames or ()), told
    except OSError as error:
        raise InputError(f"table {table} cannot be read: {error.strerror or error}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"table {table} is not CSV text: {error}; save it as CSV in UTF-8") from error


def _stated(table: Path, column: str, words: list[str], allowed: tuple[float, float]) -> float:
    """The one number of a column, millimetres; 0 where nothing stands in it."""
    found = sorted({word.strip() for word in words} - {""})
    numbers = {_number(word) for word in found}
    low, high = allowed
    if bad := [word for word in found if not low <= _number(word) <= high]:
        raise InputError(f"{table}: {column} is '{bad[0]}'; allowed are millimetres, {low:g} to {high:g}")
    if len(numbers) > 1:
        raise InputError(
            f"{table}: {column} is '{found[0]}' and '{found[-1]}'; a folder has one belt, and one resting level: make "
            "a folder of each"
        )
    return numbers.pop() if numbers else 0.0


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def resting_told(folder: Path) -> str:
    """For people: with which resting level the views of a folder are read and how to state another; empty where tubers
    lie on the belt, and for other layouts.

    Raises:
        InputError: as `twin_resting`.
    """
    level, source = level_of(folder) if is_potatotwin(folder) else (RestingLevel(), "belt")
    if level == RestingLevel():
        return ""
    offset_mm, sd_mm = 1000 * level.offset_m, 1000 * level.sd_m
    told = f"{folder}: tubers are taken to lie {offset_mm:g} mm below the belt (sd {sd_mm:g} mm)"
    if source == "stated":
        return f"{told}, as {OFFSET} of {TRUTH} states"
    return (
        f"{told}, as measured on R9-9 of 3DPotatoTwin. Of a belt of your own {TRUTH} states it: columns {OFFSET} (0: "
        f"on the belt) and {SD}, or belt_distance_m, with which they lie on the belt"
    )
