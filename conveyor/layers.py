"""Tubers that lie on others: the flag that says so in the ledger, and what a person reads of such a belt."""

from __future__ import annotations

import re
from collections.abc import Iterable

_FLAG = re.compile(r"on_others_(\d{1,4})_mm")


def on_others_flag(support_mm: float) -> str:
    """The flag of a tuber whose underside lies `support_mm` above the belt, in whole millimetres."""
    return f"on_others_{round(support_mm)}_mm"


def support_mm_of(flags: Iterable[str]) -> float:
    """How high a tuber with these flags lies on others, millimetres; 0 where it lies on the belt."""
    found = [_FLAG.fullmatch(flag) for flag in flags]
    return max((float(one.group(1)) for one in found if one), default=0.0)


def layers_in_words(hidden: float, layered_m: float, belt_m: float | None) -> str:
    """What is said of a load with more than one layer; '' where the belt carries one.

    Args:
        hidden: tubers estimated to lie under others.
        layered_m: belt with more than one layer; belt_m: all of it, None where that is not known.
    """
    if layered_m <= 0:
        return ""
    where = f"{layered_m:.1f} m" if not belt_m else f"{100 * min(1.0, layered_m / belt_m):.0f} %"
    return f"tubers lie in more than one layer on {where} of the belt: {hidden:.0f} hidden, estimated"
