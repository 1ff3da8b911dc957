"""Numbers of a fitted rule as its file holds them: finite, and as many as the rule takes.

A rule with other lengths than its names would be read beyond its end, and one that holds no number weighs everything as
none: both are refused where they are read.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any


def number(data: Mapping[str, Any], name: str) -> float:
    """The number `name` of a rule.

    Raises:
        ValueError: it is missing, or no finite number.
    """
    return _finite(data.get(name), name)


def numbers(data: Mapping[str, Any], name: str, count: int | None = None) -> tuple[float, ...]:
    """The numbers `name` of a rule; `count`: how many they must be, None is any number of them.

    Raises:
        ValueError: they are missing, are others in number, or one is no finite number.
    """
    values = data.get(name)
    if not isinstance(values, list | tuple):
        raise ValueError(f"{name} is {values!r}, not a list of numbers")
    if count is not None and len(values) != count:
        raise ValueError(f"{name} has {len(values)} numbers, and this rule takes {count}")
    return tuple(_finite(value, name) for value in values)


def _finite(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{name} holds {value!r}, which is no number")
    return float(value)
