"""Parts of a whole that are rounded and still add up to it: by the method of the largest remainder."""

from __future__ import annotations

import math
from collections.abc import Sequence


def rounded_to_sum(parts: Sequence[float], *, digits: int = 0) -> list[float]:
    """Each of `parts` (>= 0) rounded down or up to `digits` decimals, so that they add up to their sum as rounded.

    Those are rounded up that are cut by most; of two that are cut alike the first one.
    """
    step = 10.0**-digits
    steps = [math.floor(part / step + 1e-9) for part in parts]  # 0.3 / 0.1 is a little less than 3
    missing = round(sum(parts) / step) - sum(steps)
    by_rest = sorted(range(len(parts)), key=lambda n: steps[n] - parts[n] / step)
    for n in by_rest[: max(0, missing)]:
        steps[n] += 1
    return [round(each * step, digits) for each in steps]
