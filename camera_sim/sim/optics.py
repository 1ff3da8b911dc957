"""The cameras that are simulated: RealSense D405 in two resolutions."""

from __future__ import annotations

from dataclasses import dataclass

from conveyor.errors import InputError
from conveyor.geometry import Intrinsics

BASELINE_M = 0.018
"""Distance of the D405's imagers."""


@dataclass(frozen=True, slots=True)
class Optics:
    """One resolution of a stereo camera."""

    name: str
    intrinsics: Intrinsics


D405_1280 = Optics("d405-1280", Intrinsics(1280, 720, 653.763, 652.116, 643.484, 366.065))
"""The camera of the 3DPotatoTwin data set (corepp, data/potato_example/realsense/intrinsic.json)."""
D405_848 = Optics("d405-848", Intrinsics(848, 480, 433.118, 432.027, 426.308, 244.043))
"""The same camera's image at 848x480: its 1280x720 intrinsics times 848/1280."""
ALL_OPTICS = {optics.name: optics for optics in (D405_1280, D405_848)}


def optics_named(name: str) -> Optics:
    """The camera preset `name`, or an error that lists them."""
    if name not in ALL_OPTICS:
        raise InputError(f"camera preset '{name}' is unknown; known: {', '.join(ALL_OPTICS)}")
    return ALL_OPTICS[name]
