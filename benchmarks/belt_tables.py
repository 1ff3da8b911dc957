"""The tables of frames of a folder recording: how its belt moved, and the same belt without that."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path


def travel_told(frames_csv: Path) -> list[tuple[int, float]]:
    """(capture time, travel in metres) of each frame."""
    with frames_csv.open(newline="") as file:
        return [(int(row["captured_ns"]), float(row["travel_m"])) for row in csv.DictReader(file)]


def without_travel(recording: Path, out: Path) -> Path:
    """A copy of the recording whose belt's travel is left to be told, or estimated; returns `out`."""
    shutil.copytree(recording, out)
    for table in out.glob("*/frames.csv"):
        head, *rows = table.read_text().splitlines()
        table.write_text("\n".join([head, *(row.rpartition(",")[0] + "," for row in rows)]) + "\n")
    return out
