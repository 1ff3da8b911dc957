"""Progress for people goes to stderr, results to stdout; a log gets no bars."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn


def console() -> Console:
    """A console on stderr."""
    return Console(stderr=True)


def progress_bar(*, transient: bool = False) -> Progress:
    """A bar with the time that remains; nothing in a log.

    `transient`: it goes when the work is done.
    """
    shown = console()
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    return Progress(*columns, console=shown, disable=not shown.is_terminal, transient=transient)


Work = Callable[[str, int, int | None], None]
"""Called with what is done now in words, how much of it is done, and how much there is (None: no one knows)."""


@contextmanager
def work_bar(words: str) -> Iterator[Work]:
    """A bar over work that says itself how far it is; it goes when the work is done. A new part of it (fewer done than
    before, or of another amount) has a remaining time of its own.
    """
    with progress_bar(transient=True) as progress:
        task = progress.add_task(words, total=None)
        before: tuple[int, int | None] = (0, None)

        def on_work(said: str, done: int, total: int | None) -> None:
            nonlocal before
            if total != before[1] or done < before[0]:
                progress.reset(task, total=total)
            before = done, total
            progress.update(task, description=said, completed=done)

        yield on_work


@contextmanager
def ledger_bar(words: str = "ledger") -> Iterator[Work]:
    """A bar over all readings of ledgers within the block; what it gives is called with what comes after them."""
    from aggregator.ledger.verified import told_rows

    with work_bar(words) as on_work, told_rows(on_work):
        yield on_work


@contextmanager
def frames_bar(words: str = "frames") -> Iterator[Callable[[int, int | None], None]]:
    """A bar over the frames of a recording, which goes when they are read; call what it gives with how many are done
    and how many there are.
    """
    with progress_bar(transient=True) as progress:
        task = progress.add_task(words, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
