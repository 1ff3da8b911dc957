"""Telling how far long work is: what is done now, how much of it, and of how much."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from regressor.training.labelled import count_labelled

Work = Callable[[str, int, int | None], None]
"""Called with words, how much is done, and how much there is (None: no one knows)."""


Told = Callable[[Path, str], None]
"""Called with a folder and which of its views are left out, in words; not where none are."""


def not_told(folder: Path, words: str) -> None:
    """Says nothing."""


def no_work(words: str, done: int, of: int | None) -> None:
    """Says nothing."""


def preparing(folder: Path, on_work: Work, *, split: str | None = None) -> Callable[[int], None]:
    """For `load_cloudset`, whose counts start again with every pack of `folder`."""
    total, before, last = count_labelled(folder, split=split), 0, 0

    def on_views(done: int) -> None:
        nonlocal before, last
        if done < last:
            before += last
        last = done
        on_work(f"preparing {folder.name}", min(before + done, total), total)

    return on_views
