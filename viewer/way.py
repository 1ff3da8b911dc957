"""The machine's way as it is drawn: bounded, whatever a day brings."""

from __future__ import annotations

import math

from conveyor.geometry import EARTH_M_PER_DEG

MOST_PLACES = 4000
STEP_M = 1.0


class Way:
    """Places in degrees, oldest first: steps of less than `STEP_M` are left out, an old way keeps every second one."""

    def __init__(self) -> None:
        self.lon_lat: list[tuple[float, float]] = []

    def add(self, *, lat_deg: float, lon_deg: float) -> bool:
        """Where the machine is now; False where that is no step."""
        if self.lon_lat and _metres(self.lon_lat[-1], (lon_deg, lat_deg)) < STEP_M:
            return False
        self.lon_lat.append((lon_deg, lat_deg))
        if len(self.lon_lat) > MOST_PLACES:
            self.lon_lat = self.lon_lat[:-1:2] + self.lon_lat[-1:]
        return True


def _metres(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Between two places (lon, lat) that are near each other."""
    east = (a[0] - b[0]) * math.cos(math.radians(a[1])) * EARTH_M_PER_DEG
    return math.hypot(east, (a[1] - b[1]) * EARTH_M_PER_DEG)
