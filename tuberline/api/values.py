"""What a caller gave: a number that is allowed, before anything is computed with it; and what it is called."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np

from conveyor.errors import InputError, TuberlineError

P = ParamSpec("P")
R = TypeVar("R")


def by_parameters(function: Callable[P, R]) -> Callable[P, R]:
    """`function`, whose errors name its parameters: what it shares with a command calls `belt_distance_m` by the
    command's option, `--belt-distance-m`.
    """
    names = {*inspect.signature(function).parameters, "depth_scale_m"}  # by which a cloud was made

    def name(option: re.Match[str]) -> str:
        found = option[1].replace("-", "_")
        return found if found in names else option[0]

    @wraps(function)
    def named(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except TuberlineError as error:
            error.args = (re.sub(r"--([a-z][a-z-]*[a-z])", name, str(error)), *error.args[1:])
            raise

    return named


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
