"""Weights of loads in the unit that a person reads; what machines read is in grams, or says its unit."""

from __future__ import annotations

import re
from collections.abc import Iterable

GRAMS = {"kg": 1e3, "t": 1e6, "lb": 453.59237}
_SAID_KG = r"(?<![\w.])(\d+(?:\.\d+)?(?:e[+-]?\d+)?) kg\b"


def in_unit(said: str, unit: str, *, names: Iterable[str] = ()) -> str:
    """What a line said, which says kilograms, with weights in `unit`; `names` of loads stay as persons gave them."""
    if unit == "kg":
        return said
    kept = sorted(map(re.escape, filter(None, names)), key=len, reverse=True)

    def told(found: re.Match[str]) -> str:
        return found[0] if found[1] is None else ticket_in(1000 * float(found[1]), unit)

    return re.sub("|".join((*kept, _SAID_KG)), told, said)


def ticket_in(grams: float, unit: str) -> str:
    """What a scale said, with its unit: to a tenth of a kilogram or pound, or to 100 g."""
    return f"{grams / GRAMS[unit]:.{4 if unit == 't' else 1}f} {unit}"


def digits_of(grams: float, unit: str) -> int:
    """Decimals with which a load has four figures or so."""
    figure = abs(grams) / GRAMS[unit]
    if unit == "t":
        return 3 if figure < 10 else 2
    return 2 if figure < 100 else 1 if figure < 1000 else 0
