"""How a finished run is told to a person."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from aggregator.core.reasons import unseen_in_words
from conveyor.apart import apart_told
from conveyor.exchanged import exchanged_told
from conveyor.layers import layers_in_words
from conveyor.messages import CameraExchanged, CamerasApart
from tuberline.cli.class_table import class_table, foreign_line
from tuberline.cli.live import histogram_lines

WORTH_TELLING_PERCENT = 0.5
"""Of foreign matter, where none was refused: less is the classifier's doubt alone."""


def print_summary(console: Console, summary: dict[str, Any], *, out: Path) -> None:
    """The load, its histogram, what was lost, and where the files are."""
    totals = summary["totals"]
    if summary.get("state") == "nothing seen":
        console.print(f"[bold red]nothing seen[/]: {escape(str(summary['reason']))}", highlight=False)
    else:
        _print_load(console, summary, totals)
    apart = [CamerasApart(**one) for one in totals.get("apart", ())]
    exchanged = [exchanged_told(CameraExchanged(**one)) for one in totals.get("exchanged", ())]
    told = [*(apart_told(one) for one in apart if one.alarm), *exchanged]
    for finding in [*summary.get("findings", []), *told]:
        console.print(f"warning: {finding}", style="yellow", markup=False, highlight=False)
    for name, n in summary.get("restarts", {}).items():
        console.print(f"[yellow]{name} was restarted {n} times[/]")
    files = ", ".join(str(out / name) for name in ("ledger.db", "summary.json", "tubers.csv"))
    console.print(f"files: {files}", markup=False, highlight=False)


def _print_load(console: Console, summary: dict[str, Any], totals: dict[str, Any]) -> None:
    coverage = totals["coverage"]
    not_known = f"not known: {summary['reason']}" if summary.get("reason") else "unknown"
    seen = not_known if coverage is None else f"{100 * coverage:.1f} %"
    unseen = unseen_in_words(summary.get("unseen_m", {}), decimals=2)
    table = Table(show_header=False, box=None, padding=(0, 2))
    weight = f"[bold]{totals['weight_g'] / 1000:.3f} kg[/]  (90 %: {_range(totals, '')})"
    table.add_row("load as seen", weight if totals["count"] else "nothing was counted, so nothing was weighed")
    table.add_row("tubers", f"[bold]{totals['count']}[/]")
    table.add_row("belt seen", escape(seen) + (f"  (not seen {unseen})" if unseen else ""))
    layers = layers_in_words(totals.get("hidden", 0.0), totals.get("layered_m", 0.0), totals.get("belt_m"))
    if layers:
        table.add_row("layers", f"[yellow]{layers}[/]")
    missed = totals["estimated_high_g"] > totals["high_g"] if coverage is None else coverage < 1
    if layers or (missed and (totals["count"] or totals["estimated_high_g"] > 0)):
        table.add_row(
            "load as estimated", f"{totals['estimated_weight_g'] / 1000:.3f} kg  (90 %: {_range(totals, 'estimated_')})"
        )
    for name, text in _calibration(totals):
        table.add_row(name, escape(text))
    table.add_row(
        "balance sheet", "[green]balanced[/]" if summary["balanced"] else "[red]DOES NOT BALANCE[/] (tuberline audit)"
    )
    console.print(table)
    for line in histogram_lines(tuple(totals["histogram"]), step_g=totals["histogram_step_g"]):
        console.print(line, highlight=False)
    if (foreign := totals.get("foreign")) and (foreign["kinds"] or foreign["percent"] >= WORTH_TELLING_PERCENT):
        console.print(foreign_line(foreign), markup=False, highlight=False)
    if totals.get("classes"):
        console.print(class_table(totals["contract"], totals["classes"]))


def _calibration(totals: dict[str, Any]) -> list[tuple[str, str]]:
    """By what the load is calibrated, and what its interval is made of; a summary of version 0.1 does not say."""
    rows = []
    if totals.get("calibrated_by"):
        rows.append(("calibrated by", totals["calibrated_by"]))
        rows.append(("as weighed", f"{totals['as_weighed_g'] / 1000:.3f} kg"))
    elif "calibrated_by" in totals:
        rows.append(("calibrated by", "nothing; one weighed bucket narrows the interval (tuberline calibrate bucket)"))
    parts = totals.get("parts_percent") or {}
    if parts:
        rows.append(("its 90 % interval", ", ".join(f"{name} {part:.1f} %" for name, part in parts.items())))
    return rows


def _range(totals: dict[str, Any], prefix: str) -> str:
    return f"{totals[f'{prefix}low_g'] / 1000:.3f} to {totals[f'{prefix}high_g'] / 1000:.3f} kg"


def print_score(console: Console, score: dict[str, Any]) -> None:
    """How far a run was from the truth."""
    table = Table("against the truth", "truth", "counted", "off by")
    table.add_row("tubers", str(score["true_count"]), str(score["count"]), _percent(score["count_error_percent"]))
    true, weighed = f"{score['true_weight_g'] / 1000:.3f} kg", bool(score["count"])
    seen = f"{score['weight_g'] / 1000:.3f} kg" if weighed else "nothing weighed"
    table.add_row("load", true, seen, _percent(score["weight_error_percent"] if weighed else None))
    if score["estimated_weight_g"] != score["weight_g"]:
        estimated = f"{score['estimated_weight_g'] / 1000:.3f} kg"
        table.add_row("load as estimated", true, estimated, _percent(score["estimated_error_percent"]))
    console.print(table)
    console.print(
        f"missed {score['missed']}, counted twice {score['double_counted']}, false {score['false']}; per tuber "
        f"MAE {_grams(score['mae_g'])}, RMSE {_grams(score['rmse_g'])}, bias {_grams(score['bias_g'], sign='+')}",
        highlight=False,
    )


def _percent(error: float | None) -> str:
    return "unknown" if error is None else f"{error:+.1f} %"


def _grams(value: float | None, *, sign: str = "") -> str:
    return "unknown" if value is None else f"{value:{sign}.1f} g"
