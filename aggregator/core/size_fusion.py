"""Sizes by several views of one tuber to one, as weights are fused: what the views share does not average out."""

from __future__ import annotations

import math
from collections.abc import Sequence

from conveyor.messages import Sizes
from conveyor.messages.sizes import MEASURES

SHARED_SHARE = 0.85
"""Share of one view's error variance that all views of the tuber have in common (docs/sizes.md)."""
LEAST_SD_MM = 0.05


def fuse_sizes(views: Sequence[Sizes]) -> Sizes | None:
    """One estimate from those of all views, each weighted by its inverse variance; None where there is none.

    The views come in any order and the sums are exact: a ledger does not depend on which answer came first.
    """
    if not views:
        return None
    found: dict[str, float] = {}
    for measure in MEASURES:
        said = [view.of(measure) for view in views]
        weights = [1 / max(sd_mm, LEAST_SD_MM) ** 2 for _, sd_mm in said]
        total = math.fsum(weights)
        found[f"{measure}_mm"] = math.fsum(w * mm for w, (mm, _) in zip(weights, said, strict=True)) / total
        alone = math.sqrt(len(views) / total)
        found[f"{measure}_sd_mm"] = alone * math.sqrt(SHARED_SHARE + (1 - SHARED_SHARE) / len(views))
    return Sizes(**found)
