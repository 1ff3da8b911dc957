"""Is what a caller gave a number that is allowed? Asked before anything is computed with it."""

from __future__ import annotations

from typing import Any

import numpy as np

from conveyor.errors import InputError


def holds(value: Any, bounds: tuple[float, float], *, whole: bool = False) -> bool:
    """One number from the first of `bounds` to the second; neither NaN, nor text, nor an array of several."""
    low, high = bounds
    try:
        return bool(np.ndim(value) == 0 and low <= value <= high and (not whole or value == int(value)))
    except (TypeError, ValueError):
        return False


def is_number(value: Any) -> bool:
    """One real number, NaN included; neither text nor an array of several."""
    try:
        return bool(np.ndim(value) == 0 and np.asarray(value).dtype.kind in "fiu")
    except ValueError:  # lists of different lengths
        return False


def in_range(name: str, value: float, bounds: tuple[float, float], *, whole: bool = False) -> float:
    """The value of the argument `name`, where it is allowed.

    Raises:
        InputError: it is not; with the name, the value and what is.
    """
    if not holds(value, bounds, whole=whole):
        low, high = bounds
        given = f"{value}" if is_number(value) else f"{value!r}, which is no number"
        raise InputError(f"{name} is {given}; allowed is {low:g} to {high:g}{', a whole number' if whole else ''}")
    return value
