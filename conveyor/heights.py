"""What is said where tubers lie lower, or higher, than those of earlier loads."""

from __future__ import annotations

from collections.abc import Iterable

from conveyor.messages import HeightChange
from conveyor.statistics import NORMAL_90


def heights_in_words(changes: Iterable[HeightChange]) -> str:
    """One sentence for each alarm; '' where there is none."""
    return "; ".join(heights_told(change) for change in changes if change.alarm)


def heights_told(change: HeightChange) -> str:
    """How the heights under one camera, or several, changed; errors as half of a 90 % interval."""
    way = "lower" if change.lower_mm > 0 else "higher"
    loads = "an earlier load" if change.loads == 1 else f"{change.loads} earlier loads"
    sure_mm, scale_sure = NORMAL_90 * change.lower_sd_mm, NORMAL_90 * change.scale_sd_percent
    return (
        f"under camera {change.cameras} tubers lie {abs(change.lower_mm):.1f} mm {way} (± {sure_mm:.1f}) than in "
        f"{loads} of this variety; height over width {change.scale_percent:+.0f} % (± {scale_sure:.0f})"
    )
