"""Progress for people goes to stderr, results to stdout; a log gets no bars."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

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


@contextmanager
def frames_bar(words: str = "frames") -> Iterator[Callable[[int, int | None], None]]:
    """A bar over the frames of a recording, which goes when they are read; call what it gives with how many are done
    and how many there are.
    """
    with progress_bar(transient=True) as progress:
        task = progress.add_task(words, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
