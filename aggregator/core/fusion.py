"""Views of one tuber to one weight with a 90 % interval.

A tuber's views share most of their error (its shape, its density, the belt height): in simulation 31 views cut the
error by 13 % and 7 by 10 % (docs/ledger.md). So n views have the variance `s + (1 - s) / n` of one view, not `1 / n`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from conveyor.messages import WeighedView
from conveyor.statistics import NORMAL_90

SHARED_SHARE = 0.77
"""Share of one view's error variance that all views of the tuber have in common: sqrt(.77 + .23 / n) is .88 for n = 31
and .90 for n = 7. The 281 tubers of PointSDF give .71 (2023) and .93 (2025), weights by volume here .70 to .80."""

OUTLIER_SD = 4.0
"""A view this many within-tuber standard deviations from the median is left out, if most views remain."""

VOLUME_G_PER_ML = 0.94
"""Grams per ml of visible volume down to the belt: below the density, because that volume fills the undercut. Median of
1125 simulated tubers (0.938); 0.95 for tubers at rest, 0.935 for tumbling ones (docs/ledger.md)."""

VOLUME_HALF_WIDTH = 0.20
"""Half of the 90 % interval of a weight by volume, as a share of it: simulated 0.83 to 1.17 on a rough belt, and more
where the belt's height is off."""

AXES_G_PER_ML = 1.186
"""Weight of a tuber over its ellipsoid's volume (421 tubers: 1.186 +- .089 g/ml)."""

MOST_MODEL_CHARACTERS = 4096
"""A line has one or two sets of weights at a time; what names more than these is cut."""

MEAN_WEIGHT_G, LIGHTEST_G, HEAVIEST_G = 172.0, 16.0, 624.0
"""Mean and range of 859 weighed tubers: what is left to say about a tuber that was counted but never measured."""


@dataclass(frozen=True, slots=True)
class FusedWeight:
    """Weight of one tuber, grams, with its 90 % interval; `views` were used, `method` and `model` say by what."""

    weight_g: float
    low_g: float
    high_g: float
    views: int
    method: str
    model: str
    flags: tuple[str, ...]


def fuse(views: Sequence[WeighedView], *, visible_volumes_ml: Sequence[float], axes_mm: Sequence[float]) -> FusedWeight:
    """One weight from all answered views of a tuber, or from its size where there are none.

    Args:
        views: of all its tracks, any order.
        visible_volumes_ml: of its tracks, the fallback.
        axes_mm: length, width and height, the fallback's fallback.
    """
    by_network = [view for view in views if view.method == "pointraft"]
    chosen = sorted(by_network or views, key=lambda view: view.view_id)
    if not chosen:
        return weight_by_size(visible_volumes_ml, axes_mm)
    kept = without_outliers(chosen)
    flags = {flag for view in kept for flag in view.flags}
    if len(kept) < len(chosen):
        flags.add("outlier_view")
    mean_g, shrink = _mean_and_shrink(kept)
    lower_g = sum(view.weight_g - view.low_g for view in kept) / len(kept)
    upper_g = sum(view.high_g - view.weight_g for view in kept) / len(kept)
    return FusedWeight(
        weight_g=mean_g,
        low_g=max(0.0, mean_g - shrink * max(lower_g, 0.0)),
        high_g=mean_g + shrink * max(upper_g, 0.0),
        views=len(kept),
        method=kept[0].method,
        model="+".join(sorted({view.model for view in kept}))[:MOST_MODEL_CHARACTERS],
        flags=tuple(sorted(flags)),
    )


def weight_by_size(visible_volumes_ml: Sequence[float], axes_mm: Sequence[float]) -> FusedWeight:
    """Weight from the visible volume, else from the axes, else what any tuber weighs; always with a wide interval."""
    volumes = [volume for volume in visible_volumes_ml if volume > 0]
    if volumes:
        weight_g = VOLUME_G_PER_ML * median(volumes)
        flags: tuple[str, ...] = ("no_view_weighed",)
    elif min(axes_mm, default=0.0) > 0:
        weight_g = AXES_G_PER_ML * math.pi / 6 * math.prod(axes_mm) / 1000
        flags = ("no_view_weighed", "no_volume")
    else:
        return FusedWeight(
            MEAN_WEIGHT_G, LIGHTEST_G, HEAVIEST_G, 0, "volume", "", ("never_measured", "no_view_weighed", "no_volume")
        )
    spread_g = VOLUME_HALF_WIDTH * weight_g
    return FusedWeight(weight_g, weight_g - spread_g, weight_g + spread_g, 0, "volume", "", flags)


def without_outliers(views: Sequence[WeighedView]) -> list[WeighedView]:
    """The views that agree with the median, as long as more than half do; with fewer than three, all of them."""
    if len(views) < 3:
        return list(views)
    middle_g = median(view.weight_g for view in views)
    within = math.sqrt(1.0 - SHARED_SHARE)
    kept = [view for view in views if abs(view.weight_g - middle_g) <= OUTLIER_SD * within * _sd_g(view)]
    return kept if 2 * len(kept) > len(views) else list(views)


def _mean_and_shrink(views: Sequence[WeighedView]) -> tuple[float, float]:
    """Inverse-variance mean, and its interval as a share of one view's.

    Where the views scatter more than their own intervals allow, the interval grows with them instead of hiding it.
    """
    shares = [1.0 / _sd_g(view) ** 2 for view in views]
    total = sum(shares)
    mean_g = sum(share * view.weight_g for share, view in zip(shares, views, strict=True)) / total
    effective = total**2 / sum(share**2 for share in shares)
    shrink2 = SHARED_SHARE + (1.0 - SHARED_SHARE) / effective
    if len(views) > 1:
        chi2 = sum(share * (view.weight_g - mean_g) ** 2 for share, view in zip(shares, views, strict=True))
        excess = chi2 / (len(views) - 1) / (1.0 - SHARED_SHARE)
        shrink2 += max(0.0, excess - 1.0) * (1.0 - SHARED_SHARE) / effective
    return mean_g, math.sqrt(shrink2)


def _sd_g(view: WeighedView) -> float:
    """Standard deviation behind a view's interval; at least 1 % of the weight and half a gram."""
    return max((view.high_g - view.low_g) / (2 * NORMAL_90), 0.01 * abs(view.weight_g), 0.5)
