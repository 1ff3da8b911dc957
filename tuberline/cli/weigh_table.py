"""Tables for people."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Column, Table

from regressor.weigh.files import FileResult


def weight_table(results: Sequence[FileResult]) -> Table:
    """What was weighed, one row per file."""
    figures = [Column(name, no_wrap=True) for name in ("weight", "90 % interval", "height", "points")]
    table = Table(Column("file", overflow="fold"), *figures, "by", "flags")
    for result in results:
        answer = result.weighed
        if answer is None:
            table.add_row(result.path.name, "[red]not weighed", "", "", str(result.points), "", "")
            continue
        table.add_row(
            result.path.name,
            f"[bold]{answer.weight_g:.1f} g",
            f"{answer.low_g:.1f} to {answer.high_g:.1f} g",
            f"{result.height_mm:.1f} mm",
            str(result.points),
            answer.model,
            ", ".join(answer.flags),
        )
    return table
