"""What is said where two cameras put the same tubers at different places."""

from __future__ import annotations

from collections.abc import Iterable

from conveyor.messages import CamerasApart


def apart_in_words(found: Iterable[CamerasApart]) -> str:
    """One sentence for each alarm; '' where there is none."""
    return "; ".join(apart_told(apart) for apart in found if apart.alarm)


def apart_told(apart: CamerasApart) -> str:
    """By how much two cameras disagree, and what that does."""
    twice = f"{apart.twice} of {apart.shared} counted twice" if apart.twice else "none counted twice yet"
    return (
        f"cameras {apart.first} and {apart.second} put the same tubers {abs(apart.along_mm):.0f} mm apart along the "
        f"belt and {abs(apart.across_mm):.0f} mm across, {twice}. A camera moved, its place is not right or, "
        "along the belt, two clocks differ: record both, then run `tuberline calibrate cameras`"
    )
