"""A running replay in a terminal: the line's table, and how long its frames still take."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console, Group
from rich.live import Live

from conveyor.messages import Counters, Totals
from tuberline.cli.live import line_table
from tuberline.cli.progress import console, progress_bar

Show = Callable[[Totals | None, Mapping[str, Counters], set[str]], None]
"""Called with the newest totals, the newest counters by node, and the nodes that are there."""


@contextmanager
def replay_table(frames: int | None, *, on: Console | None = None) -> Iterator[Show]:
    """The table stands until the block ends, on stderr or on the console `on`, and only where that is a terminal.

    Args:
        frames: how many the recording has; None where it does not say.
    """
    bar = progress_bar()
    task = bar.add_task("frames", total=frames)
    before: dict[str, int] = {}
    with Live(console=on or console(), refresh_per_second=4, transient=True) as live:

        def show(totals: Totals | None, nodes: Mapping[str, Counters], alive: set[str]) -> None:
            nonlocal before
            done = {name: of.count("frames_processed") for name, of in nodes.items() if of.role == "segmenter"}
            # What a camera had done when it is first heard, before a --resume for one, says nothing of the pace.
            if done.keys() != before.keys() or any(done[name] < count for name, count in before.items()):
                bar.reset(task, completed=sum(done.values()))
            looked = sum(of.count("frames_looked_first") for of in nodes.values())
            first = looked > 0 and not any(done.values())
            words = f"looked first at {looked} frames" if first else "frames"
            bar.update(task, completed=sum(done.values()), description=words)
            before = done
            live.update(Group(line_table(totals, nodes, alive=alive), bar.get_renderable()))

        yield show
