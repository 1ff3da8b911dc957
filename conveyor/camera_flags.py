"""Flags of tubers that say what was wrong with the camera when they passed."""

from __future__ import annotations

from collections.abc import Iterable

CAMERA_NOISE = "camera_noise"
"""Its camera was noisier than those that the weights were trained for."""
CAMERA_UNLIKE = "camera_unlike"
"""Noise and holes on its skin are those of a poor camera, unlike those of a good one."""
OUTLINE_GROWN = "outline_grown"
"""It carries depth out over outlines, as tubers before this one have told; what it grew was cut off."""
OUTLINE_LOST = "outline_lost"
"""It takes more off outlines than the weights know: the weight is larger by what that makes lighter."""
FLANKS_RAISED = "flanks_raised"
"""Its matching window raises flanks near outlines; what it raised was taken off before the tuber was weighed."""
SCALED_BY_TRAVEL = "scaled_by_travel"
"""Its distances contradicted the belt's travel, which is its gauge; the tuber was scaled to agree with it."""
BELT_DISTANCE = "belt_distance"
"""Its belt is nearer or farther away than any that the weights were trained on."""
MOUNT_MOVED = "mount_moved"
"""The camera was nearer to the belt, or farther, than calibrated: heights are from the belt as it is seen."""
CUT = "cut"
"""It lies at the image's border in every view: a part of it may lie outside, and its weight is then too small."""
DEPTH_DRIFT = "depth_drift"
"""Its disparity had drifted; the depth was corrected by the gauge."""
DEPTH_DRIFT_BEYOND = "depth_drift_beyond"
"""Its disparity had drifted by more than is corrected: the weight is wrong."""
RODS_UNSEEN = "rods_unseen"
"""Rods of a known pitch are its gauge, and were looked for in vain: its depth is as well known as without one."""

OFF_FROM_MM, OFF_TO_MM = 3, 20
"""How far off the belt is seen before it is told, and what is no belt any more: one that is farther off is refused
(`REFUSE_M` of the segmenter), or it is the ground that is seen.
"""
_OFF = "belt_off_"


def belt_off_flag(off_m: float) -> tuple[str, ...]:
    """The flag of a belt seen so far off its calibration, with no gauge to say why; none where that is little."""
    off_mm = round(1000 * abs(off_m))
    return (f"{_OFF}{off_mm}mm",) if OFF_FROM_MM <= off_mm <= OFF_TO_MM else ()


def belt_off_mm(flags: Iterable[str]) -> int:
    """By how much the belt was off, of a tuber's flags; 0 where nothing is said."""
    said = [flag.removeprefix(_OFF).removesuffix("mm") for flag in flags if flag.startswith(_OFF)]
    return max((int(mm) for mm in said if mm.isdigit() and len(mm) < 4), default=0)
