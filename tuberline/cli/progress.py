"""Progress for people goes to stderr, results to stdout; a log gets no bars."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn


def console() -> Console:
    """A console on stderr."""
    return Console(stderr=True)


def progress_bar(*, total_known: bool = True, transient: bool = False) -> Progress:
    """A bar with the time that remains, or words alone where no one knows how much there is; nothing in a log.

    `transient`: it goes when the work is done.
    """
    shown = console()
    words = TextColumn("{task.description}")
    columns = (words, BarColumn(), TaskProgressColumn(), TimeRemainingColumn()) if total_known else (words,)
    return Progress(*columns, console=shown, disable=not shown.is_terminal, transient=transient)
