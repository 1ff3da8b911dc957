"""The classes of a contract, and what is no tuber, as tables and lines for a person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table
from rich.text import Text

from conveyor.rounding import rounded_to_sum

KINDS = {"lump": ("clod or stone", "clods or stones"), "haulm": ("stalk of haulm", "stalks of haulm")}
"""One and several bodies of a kind that the ledger knows."""
COLOURS = {"kept": "green", "open": "yellow", "broken": "red", "": ""}


def class_table(contract: str, classes: Sequence[Mapping[str, Any]]) -> Table:
    """Count, weight and share of each class with their 90 % intervals; `classes` as plain `ClassTotal`."""
    limits = any(each["state"] for each in classes)
    heads = ("class", "mm", "tubers", "kg", "% of weight", *(["contract"] if limits else []))
    table = Table(*heads, title=Text(f"classes: {contract}"), title_justify="left")
    counts = rounded_to_sum([each["count"] for each in classes])
    weights_kg = rounded_to_sum([each["weight_g"] / 1000 for each in classes], digits=2)
    percents = rounded_to_sum([each["percent"] for each in classes], digits=1)
    for each, count, weight_kg, percent in zip(classes, counts, weights_kg, percents, strict=True):
        to_mm = each["to_mm"]
        edges = f"{each['from_mm']:g} and more" if to_mm is None else f"{each['from_mm']:g} to {to_mm:g}"
        state = str(each["state"])
        table.add_row(
            Text(str(each["name"])),
            edges,
            f"{count:.0f} ({each['count_low']:.0f} to {each['count_high']:.0f})",
            f"{weight_kg:.2f} ({each['low_g'] / 1000:.2f} to {each['high_g'] / 1000:.2f})",
            f"{percent:.1f} ({each['percent_low']:.1f} to {each['percent_high']:.1f})",
            *([Text(state, style=COLOURS[state])] if limits else []),
        )
    return table


def classes_line(classes: Sequence[Any]) -> str:
    """The same in one line of markup, the contract's limits lit; `classes` are `ClassTotal`."""
    told = []
    percents = rounded_to_sum([each.percent for each in classes], digits=1)
    for each, percent in zip(classes, percents, strict=True):
        colour = COLOURS[each.state]
        text = f"{Text(each.name).markup} {percent:.1f} %"
        told.append(f"[{colour}]{text}[/]" if colour else text)
    return "   ".join(told)


def class_score_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Shares of weight against the truth; `rows` as `aggregator.scoring.classes.score_classes` gives them."""
    table = Table("class", "% of weight", "90 %", "true", "off by")
    for row in rows:
        table.add_row(
            Text(str(row["name"])),
            f"{row['percent']:.1f}",
            f"{row['percent_low']:.1f} to {row['percent_high']:.1f}",
            f"{row['true_percent']:.1f}",
            f"{row['percent'] - row['true_percent']:+.1f}",
        )
    return table


def foreign_line(foreign: Mapping[str, Any]) -> str:
    """What of a load is no tuber, in one line; `foreign` as plain `ForeignTotal`."""
    counts = [(round(n), KINDS.get(kind, (kind, kind))) for kind, n in foreign["kinds"].items()]
    kinds = ", ".join(f"{n} {one if n == 1 else many}" for n, (one, many) in counts) or "none refused"
    return (
        f"foreign matter: {foreign['percent']:.1f} % of the bodies ({foreign['percent_low']:.1f} to "
        f"{foreign['percent_high']:.1f}), {foreign['weight_percent']:.1f} % of the weight "
        f"({foreign['weight_percent_low']:.1f} to {foreign['weight_percent_high']:.1f}); {kinds}"
    )
