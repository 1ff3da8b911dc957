"""The live table of a line: totals on top, nodes below."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Group
from rich.panel import Panel
from rich.table import Table

from conveyor.messages import Counters, Totals

_SHOWN = {
    "camera": ("frames_published", "frames_resent"),
    "segmenter": ("frames_processed", "views_sent", "tracks_counted"),
    "regressor": ("views_weighed",),
    "aggregator": ("tubers_committed", "entries_applied"),
    "viewer": ("frame_shown", "tuber_shown"),
    "recorder": ("frames_written",),
}
LOSS_WORDS = ("dropped", "gap", "lost", "refused", "missed", "stall")
"""A counter whose name holds one of these tells of something that did not arrive or was not used."""


def line_table(totals: Totals | None, nodes: Mapping[str, Counters], *, alive: set[str]) -> Group:
    """What a person wants to see of a running line."""
    return Group(totals_panel(totals), nodes_table(nodes, alive=alive))


def totals_panel(totals: Totals | None) -> Panel:
    """The load so far, in one box."""
    if totals is None:
        return Panel("waiting for the first tuber ...", title="load")
    half_g = (totals.high_g - totals.low_g) / 2
    coverage = "-" if totals.coverage is None else f"{100 * totals.coverage:.1f} %"
    text = (
        f"[bold]{totals.weight_g / 1000:8.2f} kg[/] ± {half_g / 1000:.2f}   [bold]{totals.count}[/] tubers   "
        f"{totals.tubers_per_s:.1f}/s   belt seen {coverage}"
    )
    return Panel(text, title=f"load · run {totals.run}" + (" · final" if totals.final else ""))


def nodes_table(nodes: Mapping[str, Counters], *, alive: set[str]) -> Table:
    """One row a node: state, what it did, what was lost."""
    table = Table("node", "state", "up", "did", "lost or refused", expand=True)
    for name, counters in sorted(nodes.items()):
        state = counters.status if name in alive else "gone"
        colour = "green" if state == "ok" else "red"
        did = "  ".join(
            f"{key.split('_', 1)[-1]} {counters.count(key)}"
            for key in _SHOWN.get(counters.role, ())
            if counters.count(key)
        )
        counted = {**counters.gauges, **counters.values}
        lost = "  ".join(
            f"{key} {value:g}"
            for key, value in sorted(counted.items())
            if value and any(word in key for word in LOSS_WORDS)
        )
        table.add_row(
            name, f"[{colour}]{state}[/]", f"{counters.uptime_s:.0f} s", did, f"[yellow]{lost}[/]" if lost else ""
        )
    return table


def histogram_lines(histogram: tuple[int, ...], *, step_g: float, width: int = 40) -> list[str]:
    """The weight classes as bars of text."""
    most = max(histogram, default=0)
    if not most:
        return ["(no tubers)"]
    last = max(i for i, n in enumerate(histogram) if n)
    return [
        f"{i * step_g:4.0f}-{(i + 1) * step_g:<4.0f} g {'█' * round(width * n / most):<{width}} {n}"
        for i, n in enumerate(histogram[: last + 1])
    ]
