"""A web of rods is checked by its rods: where they are seen against where they are given; between lies the ground."""

from __future__ import annotations

import numpy as np

from conveyor.messages import Frame
from conveyor.resting import RestingLevel
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.constants import LOAD_M, MIN_SHARE
from segmenter.frame.plane import BeltCheck, PlaneFit, check_belt
from segmenter.gauge.points import depths_m, rays
from segmenter.gauge.rods import REACH_M, STRIDE, rods_distances_m


def check_web(frame: Frame, belt: BeltGeometry, web: RestingLevel, fit: PlaneFit | None) -> BeltCheck:
    """Compare the web given with the rods seen.

    Args:
        belt: as given; its plane is that of the rods' tops.
        web: pitch and diameter of the rods.
        fit: the dominant plane of the frame, which is the ground as a rule.

    Raises:
        InputError: another plane is seen clearly, and neither rods nor load where the web should be.
    """
    found = rods_distances_m(frame, belt, pitch_m=web.rod_pitch_m, radius_m=web.rod_diameter_m / 2)
    if found is not None:
        return BeltCheck(None, found[0] - belt.distance_m)
    check_belt(
        belt.belt_from_camera,
        fit,
        given_share=_share_there(frame, belt),
        camera=frame.camera,
        depth_scale_m=frame.depth_scale_m,
    )
    return BeltCheck(fit, None)


def _share_there(frame: Frame, belt: BeltGeometry) -> float:
    """Share of the depth seen that rods or load can be: the web may be full, or hidden by haulm.

    A web that shows neither is bare, and where no rods of its pitch are seen then, it is not there.
    """
    z = depths_m(frame, stride=STRIDE)
    _, _, up = rays(frame, belt, stride=STRIDE)
    height_m = (z * up + belt.belt_from_camera[2, 3])[np.isfinite(z)]
    if not len(height_m):
        return MIN_SHARE
    return float(np.mean((height_m > -REACH_M) & (height_m < LOAD_M)))
