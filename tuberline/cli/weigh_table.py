"""What was weighed, for people and for spreadsheets."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from regressor.weigh.files import FileResult

COLUMNS = (
    "path",
    "object",
    "weight_g",
    "low_g",
    "high_g",
    "height_mm",
    "points",
    "network_g",
    "volume_g",
    "method",
    "model",
    "flags",
    "error",
)


def weight_table(results: Sequence[FileResult]) -> RenderableType:
    """One row per file or object; names are folded, never cut. What is the same in all rows stands below."""
    figures = [Column(name, no_wrap=True, justify="right") for name in ("weight", "90 % interval", "height")]
    flagged = any(result.weighed and result.weighed.flags for result in results)
    flags = [Column("flags", overflow="fold")] if flagged else []
    table = Table(Column("file", overflow="fold"), *figures, *flags)
    for result in results:
        answer = result.weighed
        if answer is None:
            cells = ["[red]not weighed", "", ""]
        else:
            cells = [
                f"[bold]{answer.weight_g:.1f} g",
                f"{answer.low_g:.1f} to {answer.high_g:.1f} g",
                f"{result.height_mm:.1f} mm",
            ]
        told = [", ".join(answer.flags) if answer else ""] if flagged else []
        table.add_row(Text(result.name), *cells, *told)
    models = sorted({result.weighed.model for result in results if result.weighed})
    return Group(table, Text(f"weighed by {', '.join(models)}")) if models else table


def weight_csv(results: Sequence[FileResult]) -> str:
    """One line per file or object; what is not known is empty, flags are parted by blanks."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for result in results:
        writer.writerow({**(row := result.as_dict()), "flags": " ".join(row.get("flags", ()))})
    return text.getvalue()
