"""The live table of a line: totals on top, nodes below."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.markup import escape
from rich.measure import Measurement
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from conveyor.apart import apart_in_words
from conveyor.exchanged import exchanged_in_words
from conveyor.heights import heights_in_words
from conveyor.layers import layers_in_words
from conveyor.messages import Counters, LoadNow, Totals
from tuberline.cli.class_table import classes_line

_SHOWN = {
    "camera": ("frames_published", "frames_resent"),
    "segmenter": ("frames_processed", "views_sent", "tracks_counted"),
    "regressor": ("views_weighed",),
    "aggregator": ("tubers_committed", "entries_applied"),
    "viewer": ("frame_shown", "tuber_shown"),
    "recorder": ("frames_written",),
    "encoder": ("counts",),
    "gnss": ("positions",),
}
_LEVELS = {"encoder": (("travel_m", "travel {:.2f} m"), ("belt_mps", "now {:.2f} m/s"))}
AGGREGATOR = "aggregator/aggregator"
MOST_ROWS = 200
LOSS_WORDS = ("dropped", "gap", "lost", "refused", "missed", "stall")
"""A counter whose name holds one of these tells of something that did not arrive or was not used."""
NO_LOSS = ("outline_lost_px",)
"""Levels that tell of none: what a camera takes off outlines is a property of its images."""


class Pace:
    """How fast each counter grows: over the last reports of a node, which come once a second."""

    def __init__(self, reports: int = 6) -> None:
        self._reports = reports
        self._seen: dict[str, deque[Counters]] = {}

    def update(self, nodes: Mapping[str, Counters]) -> None:
        """Take the newest reports. A node that started again begins again, one that is forgotten is forgotten here."""
        for name in self._seen.keys() - nodes.keys():
            del self._seen[name]
        for name, counters in nodes.items():
            seen = self._seen.setdefault(name, deque(maxlen=self._reports))
            if seen and (counters.pid != seen[-1].pid or counters.run != seen[-1].run):
                seen.clear()
            if not seen or counters.uptime_s > seen[-1].uptime_s:
                seen.append(counters)

    def per_s(self, node: str, counter: str) -> float | None:
        """Growth per second; None before there are two reports."""
        seen = self._seen.get(node)
        if not seen or len(seen) < 2:
            return None
        return (seen[-1].count(counter) - seen[0].count(counter)) / (seen[-1].uptime_s - seen[0].uptime_s)


class Items:
    """Short texts in one cell of a table: lines break between them, not inside one."""

    def __init__(self, items: Iterable[str], *, style: str = "") -> None:
        self._items = tuple(items)
        self._style = style

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        lines: list[str] = []
        for item in self._items:
            if lines and len(lines[-1]) + 2 + len(item) <= options.max_width:
                lines[-1] += f"  {item}"
            else:
                lines.append(item)
        yield Text("\n".join(lines), style=self._style, overflow="fold")

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        longest = max((len(item) for item in self._items), default=0)
        return Measurement(longest, max(longest, len("  ".join(self._items)))).with_maximum(options.max_width)


def line_table(
    totals: Totals | None,
    nodes: Mapping[str, Counters],
    *,
    alive: set[str],
    pace: Pace | None = None,
    expected: Collection[str] = (),
    nothing: str = "",
) -> Group:
    """What a person wants to see of a running line.

    Args:
        expected: nodes that have a row, be they there or not.
        nothing: what is said of the load where no totals are known; by default that its first tuber is waited for.
    """
    tables = nodes_tables(nodes, alive=alive, pace=pace, expected=expected if alive else ())
    return Group(totals_panel(totals, nothing), *tables, *_remarks(totals, nodes, alive))


def _remarks(totals: Totals | None, nodes: Mapping[str, Counters], alive: set[str]) -> list[str]:
    """What the table alone does not say."""
    if totals is not None and not totals.final and alive and AGGREGATOR not in alive:
        return ["[red]the aggregator is not there[/]: this is the load as it told it last"]
    if not nodes and not alive:
        return [
            "[red]no process of this line is running[/]: start it with `tuberline run LINE.toml`, or correct --line"
        ]
    if not alive:
        return ["[red]no process answers[/]: the router or the whole line is down; these are the last reports"]
    return []


def totals_panel(totals: Totals | None, nothing: str = "") -> Panel:
    """The load so far, in one box; `nothing` where it is not known."""
    if totals is None:
        return Panel(nothing or "waiting for the first tuber ...", title="load")
    title = f"load · run {totals.run}" + (" · final" if totals.final else "")
    if totals.state == "nothing seen":
        return Panel(f"[bold red]nothing seen[/]: {escape(totals.reason)}", title=title)
    if totals.state == "starting" and not totals.count:
        return Panel(f"starting, not counting: {escape(totals.reason)}", title=title)
    text = _so_far(totals) + ("" if totals.final else f"   {totals.tubers_per_s:.1f}/s")
    if layers := layers_in_words(totals.hidden, totals.layered_m, totals.belt_m):
        text += f"\n[yellow]{layers}[/]: with them {totals.estimated_weight_g / 1000:.2f} kg"
    if apart := apart_in_words(totals.apart):
        text += f"\n[yellow]{apart}[/]"
    if exchanged := exchanged_in_words(totals.exchanged):
        text += f"\n[yellow]{escape(exchanged)}[/]"
    if totals.belt_unknown:
        text += f"\n[yellow]{escape(totals.reason)}[/]"
    if totals.state == "starting":
        text += f"   [yellow]starting: {escape(totals.reason)}[/]"
    lit = classes_line(totals.load.classes if totals.load else totals.classes)
    text += f"\n{lit}" if lit else ""
    if totals.load is not None:
        if heights := heights_in_words(totals.load.heights):
            text += f"\n[yellow]{heights}[/]"
        return Panel(Text.from_markup(f"{_so_far(totals.load)}\nrun: {text}"), title=_load_title(totals.load))
    return Panel(text, title=title)


def _so_far(told: Totals | LoadNow) -> str:
    half_g = (told.high_g - told.low_g) / 2
    coverage = "-" if told.coverage is None else f"{100 * told.coverage:.1f} %"
    return (
        f"[bold]{told.weight_g / 1000:8.2f} kg[/] ± {half_g / 1000:.2f}   [bold]{told.count}[/] tubers   "
        f"belt seen {coverage}"
    )


def _load_title(load: LoadNow) -> Text:
    """Number, name and what else is known of the open load; what a person typed is no markup."""
    known = (load.name, load.trailer, load.field, load.variety, load.customer)
    return Text(" · ".join(filter(None, (f"load {load.number}", *known))))


def nodes_tables(
    nodes: Mapping[str, Counters], *, alive: set[str], pace: Pace | None = None, expected: Collection[str] = ()
) -> Iterator[Table]:
    """One row a node, with its state and what it did; then what was lost, whose names are too long to stand beside."""
    table = Table("node", "state", "up", "did", box=SIMPLE_HEAD, expand=True, padding=(0, 1, 0, 0))
    lost = Table("node", "lost or refused", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    lost.columns[0].no_wrap = True
    for column, least in zip(table.columns[:3], (15, 7, 6), strict=True):
        column.no_wrap, column.min_width = True, least
    there = alive & nodes.keys()
    names = sorted({*nodes, *alive, *expected}, key=lambda name: (name not in there, name not in expected, name))
    for name in sorted(names[:MOST_ROWS]):
        counters = nodes.get(name)
        if counters is None and name in alive:
            table.add_row(short_name(name), "[red]silent[/]", "", "there, and has not reported yet")
            continue
        if counters is None:
            table.add_row(short_name(name), "[red]gone[/]", "", "not there; `tuberline doctor` and its log say why")
            continue
        state = counters.status if name in alive else "gone"
        colour = "green" if state == "ok" else "red"
        table.add_row(
            short_name(name),
            f"[{colour}]{escape(state)}[/]",
            duration(counters.uptime_s),
            Items(_did(name, counters, pace if name in alive else None)),
        )
        if lacking := [f"{key} {value:g}" for key, value in losses(counters).items()]:
            lost.add_row(short_name(name), Items(lacking, style="yellow"))
    if len(names) > MOST_ROWS:
        table.add_row(f"and {len(names) - MOST_ROWS} more", "", "", "")
    yield table
    if lost.row_count:
        yield lost


def _did(name: str, counters: Counters, pace: Pace | None) -> Iterator[str]:
    for key in _SHOWN.get(counters.role, ()):
        if counters.count(key):
            rate = pace.per_s(name, key) if pace else None
            what = f"{key.split('_')[0]}s" if counters.role == "viewer" else key.split("_", 1)[-1]
            yield f"{what} {counters.count(key)}" + ("" if rate is None else f" ({rate:.1f}/s)")
    for key, text in _LEVELS.get(counters.role, ()):
        if key in counters.gauges:
            yield text.format(counters.gauges[key])


def losses(counters: Counters) -> dict[str, float]:
    """Every count or level above zero that tells of a loss."""
    counted = {**counters.gauges, **counters.values}
    return {
        key: float(value)
        for key, value in sorted(counted.items())
        if value > 0 and key not in NO_LOSS and any(word in key for word in LOSS_WORDS)
    }


def short_name(node: str) -> str:
    """'aggregator/aggregator' says everything twice."""
    role, _, own = node.partition("/")
    return role if role == own else node


def duration(seconds: float) -> str:
    """42 s, 7 min, 3 h 05, 2 d 4 h: short enough for a column."""
    minutes, hours = int(seconds / 60), int(seconds / 3600)
    if seconds < 100:
        return f"{seconds:.0f} s"
    if minutes < 100:
        return f"{minutes} min"
    return f"{hours} h {minutes % 60:02d}" if hours < 48 else f"{hours // 24} d {hours % 24} h"


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
