"""What a run leaves beside its ledger: summary.json and tubers.csv, each written whole or not at all."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from aggregator.core.loads import Span, span_of
from conveyor.errors import StorageError
from conveyor.files import cause, replacing
from conveyor.messages import Sizes, Tuber

RESULT_FILES = ("summary.json", "tubers.csv")
SIZES = {"caliper_length": "length", "caliper_width": "width", "caliper_thickness": "thickness", "mesh": "mesh"}
"""Sizes of the whole tuber by their names in the table; `low` and `high` bound the 90 % interval of each."""

COLUMNS = (
    "id",
    "place_x_m",
    "place_y_m",
    "weight_g",
    "low_g",
    "high_g",
    "length_mm",
    "width_mm",
    "height_mm",
    *(f"{name}{bound}_mm" for name in SIZES for bound in ("", "_low", "_high")),
    "cameras",
    "views",
    "method",
    "model",
    "flags",
    "crossed_ns",
)


def tubers_csv(tubers: Iterable[Tuber], spans: Sequence[Span] = ()) -> Iterator[str]:
    """The lines of a table with one row per tuber; lists are joined with blanks. Where loads changed in the run, with
    these `spans`, a last column has the number of the tuber's load, 0 for none."""
    line = io.StringIO()
    writer = csv.writer(line, lineterminator="\n")
    writer.writerow((*COLUMNS, "load") if spans else COLUMNS)
    for tuber in tubers:
        yield line.getvalue()
        line.seek(0)
        line.truncate()
        writer.writerow(
            (
                tuber.tuber_id,
                f"{tuber.place_x_m:.4f}",
                f"{tuber.place_y_m:.4f}",
                f"{tuber.weight_g:.2f}",
                f"{tuber.low_g:.2f}",
                f"{tuber.high_g:.2f}",
                f"{tuber.length_mm:.1f}",
                f"{tuber.width_mm:.1f}",
                f"{tuber.height_mm:.1f}",
                *_sizes(tuber.sizes),
                " ".join(tuber.cameras),
                tuber.views,
                tuber.method,
                tuber.model,
                " ".join(tuber.flags),
                tuber.crossed_ns,
                *([span_of(spans, tuber.place_x_m).load] if spans else []),
            )
        )
    yield line.getvalue()


def _sizes(sizes: Sizes | None) -> list[str]:
    """Each size with its interval; empty where nothing is said of it."""
    if sizes is None:
        return [""] * (3 * len(SIZES))
    found = [(sizes.of(measure)[0], *sizes.interval_mm(measure)) for measure in SIZES.values()]
    return [f"{value:.1f}" for row in found for value in row]


def write_whole(path: Path, text: str | Iterable[str]) -> None:
    """Replace `path` with `text` (or its parts, one after the other), durably: readers see the old file or the new one.

    Raises:
        StorageError: the disk is full or the folder cannot be written.
    """
    try:
        with replacing(path) as file:
            file.writelines(part.encode() for part in ([text] if isinstance(text, str) else text))
    except OSError as error:
        raise StorageError(f"{path} cannot be written: {cause(error)}") from error
