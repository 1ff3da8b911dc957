"""How narrow a terminal is that help and tables are laid out for."""

from __future__ import annotations

import os

LEAST_WIDTH = 40


def least_width() -> None:
    """In a narrower terminal lay everything out for `LEAST_WIDTH` columns, and let it break the lines: Rich would show
    frames without a word in two columns, and never end in one.
    """
    if _narrow():
        os.environ["COLUMNS"] = str(LEAST_WIDTH)


def _narrow() -> bool:
    """By what Rich goes by: COLUMNS, else the first stream that is a terminal; 0 is a terminal that does not say."""
    given = os.environ.get("COLUMNS", "")
    if given.isdecimal():
        return int(given) < LEAST_WIDTH
    for stream in range(3):
        try:
            return 0 < os.get_terminal_size(stream).columns < LEAST_WIDTH
        except OSError:  # no terminal
            continue
    return False
