"""The machine's way as it is drawn: bounded, whatever a day brings."""

from __future__ import annotations

import math

from conveyor.geometry import EARTH_M_PER_DEG, beside_deg

MOST_PLACES = 4000
STEP_M = 1.0
JUMP_M, AGREEING = 30.0, 5
"""A receiver's single wild places: who is told to be so far off is there when so many places in a row say so."""


class Way:
    """Places in degrees, oldest first: steps of less than `STEP_M` and wild places are left out, an old way keeps every
    second one. Longitudes go on beyond 180 where the machine crosses that meridian.
    """

    def __init__(self) -> None:
        self.lon_lat: list[tuple[float, float]] = []
        self._far: list[tuple[float, float]] = []

    def add(self, *, lat_deg: float, lon_deg: float) -> bool:
        """Where the machine is now; False where that is no step."""
        middle_deg = self.lon_lat[-1][0] if self.lon_lat else lon_deg
        place = (float(beside_deg(lon_deg, middle_deg)), lat_deg)
        step_m = _metres(self.lon_lat[-1], place) if self.lon_lat else STEP_M
        if step_m > JUMP_M and not self._stays(place):
            return False
        self._far.clear()
        if step_m < STEP_M:
            return False
        self.lon_lat.append(place)
        if len(self.lon_lat) > MOST_PLACES:
            self.lon_lat = self.lon_lat[:-1:2] + self.lon_lat[-1:]
        return True

    def _stays(self, place: tuple[float, float]) -> bool:
        """Whether the last places, this one too, lie together far from the way."""
        if self._far and _metres(self._far[-1], place) > JUMP_M:
            self._far.clear()
        self._far.append(place)
        return len(self._far) >= AGREEING


def _metres(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Between two places (lon, lat) that are near each other."""
    east = (a[0] - b[0]) * math.cos(math.radians(a[1])) * EARTH_M_PER_DEG
    return math.hypot(east, (a[1] - b[1]) * EARTH_M_PER_DEG)
