"""The command line of a benchmark: its name, its docstring as it stands, and values refused before anything runs."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from benchmarks.figures_in_docs import mark_of
from conveyor.errors import InputError

Plan = TypeVar("Plan")


def parser_of(name: str, about: str | None) -> argparse.ArgumentParser:
    """A parser for `python -m benchmarks NAME`; `about` is the module's docstring."""
    return argparse.ArgumentParser(
        prog=f"python -m benchmarks {name}", description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def whole_number(least: int) -> Callable[[str], int]:
    """An argument that is a whole number, `least` or more."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            raise argparse.ArgumentTypeError(f"'{text}': give a whole number from {least} up")
        return value

    return read


def chosen(plans: Sequence[Plan], only: Sequence[int] | None) -> list[Plan]:
    """The plans with these numbers, from 0; all of them where `only` is None.

    Raises:
        InputError: there is no such number.
    """
    unknown = sorted(number for number in only or () if number >= len(plans))
    if unknown:
        raise InputError(f"--only {unknown[0]}: there is no such number; give some from 0 to {len(plans) - 1}")
    return [plan for number, plan in enumerate(plans) if only is None or number in only]


def above_zero(text: str) -> float:
    """An argument that is a number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"'{text}': give a number above 0")
    return value


def pixels(text: str) -> tuple[int, int]:
    """An argument that is the size of an image, as 848x480: (width, height)."""
    try:
        width, height = (int(side) for side in text.split("x"))
    except ValueError:
        width = height = 0
    if min(width, height) < 1:
        raise argparse.ArgumentTypeError(f"'{text}': give WIDTHxHEIGHT in pixels, as 848x480")
    return width, height


def new_file(text: str) -> Path:
    """An argument that is a file to be written, in a folder that is there."""
    path = Path(text)
    if path.is_dir() or not path.parent.is_dir():
        raise argparse.ArgumentTypeError(f"'{text}': give a file in a folder that exists")
    return path


def page_with(*tables: str) -> Callable[[str], Path]:
    """An argument that is a page with the marks of all these tables."""

    def read(text: str) -> Path:
        page = Path(text)
        if not page.is_file():
            raise argparse.ArgumentTypeError(f"'{text}': there is no such page")
        written = page.read_text(encoding="utf-8")
        missing = [
            mark for name in tables for mark in map(mark_of, (name, name), ("begin", "end")) if mark not in written
        ]
        if missing:
            raise argparse.ArgumentTypeError(f"'{text}' lacks {missing[0]}: put it where the table shall stand")
        return page

    return read
