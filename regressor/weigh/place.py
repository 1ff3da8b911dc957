"""Whether a cloud can lie on its belt: one read with a wrong scale or distance floats above it, or lies in it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from regressor.weigh.prepare import PreparedCloud

OFF_THE_BELT = "off_the_belt"
"""Reason of a refusal."""
LOWEST_TOP_M, HIGHEST_RIM_M = 0.003, 0.12
"""No tuber is flatter than the first; none on a belt, and on tubers whose height is known, shows nothing below the
second."""

OTHER_UNIT = 30
"""So many times as far away as its belt a cloud is in another unit: in centimetres it is 100 times too far."""


def distance_fault(cloud: PreparedCloud) -> str:
    """What is wrong with a cloud that floats high above its belt or hardly rises above it; empty where nothing is."""
    lowest_m = cloud.height_m - float(cloud.points[:, 2].max() - cloud.points[:, 2].min())
    if cloud.height_m > LOWEST_TOP_M and lowest_m < HIGHEST_RIM_M:
        return ""
    nearest_m = cloud.belt_distance_m + cloud.resting_offset_m - cloud.height_m
    return distances_told(nearest_m, cloud.belt_distance_m, cloud.resting_offset_m)


def distances_told(nearest_m: float, belt_distance_m: float, resting_offset_m: float) -> str:
    """For people: how near a cloud comes to the camera, where its belt is, and what to check."""
    offset = f" (resting offset {1e3 * resting_offset_m:g} mm)" if resting_offset_m else ""
    far = nearest_m > OTHER_UNIT * belt_distance_m
    unit = "clouds are in metres, so divide one in millimetres by 1000; else " if far else ""
    return (
        f"its nearest point is {nearest_m:.3f} m from the camera and the belt {belt_distance_m:.3f} m{offset}: "
        f"{unit}check "
        "--belt-distance-m and the depth scale (--depth-scale-m: 0.001 for 1 mm units, 0.0001 for the D405's own)"
    )
