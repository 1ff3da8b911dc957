"""The field: the machine's way, and cells of the yield that somebody computes. Messages in, primitives out."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.geometry import EARTH_M_PER_DEG, beside_deg
from conveyor.messages import Position
from viewer.scene.primitives import Color, Entry, Ground, Moment, Page, YieldCells
from viewer.way import Way

WAY_COLOR: Color = (150, 150, 150)
HERE_COLOR: Color = (220, 60, 40)
WAY_EVERY, WAY_GROWTH = 10, 0.05
"""Steps of the way after which it is drawn again, and the least share of it: a long one is many bytes. The machine's
place is drawn at each step."""


class NewCells:
    """The newest cells, from the thread that computes them to the one that draws."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._found: tuple[Sequence[Mapping[str, Any]], Mapping[str, float]] | None = None

    def put(self, cells: Sequence[Mapping[str, Any]], about: Mapping[str, float]) -> None:
        """GeoJSON features, squares with `t_ha`, `low_t_ha`, `high_t_ha`; `low`, `high` and `mean` of all, t/ha."""
        with self._lock:
            self._found = cells, about

    def take(self) -> tuple[Sequence[Mapping[str, Any]], Mapping[str, float]] | None:
        """What was not taken yet; None where nothing is new."""
        with self._lock:
            found, self._found = self._found, None
        return found


class FieldScene:
    """State of the field's picture."""

    def __init__(self) -> None:
        self._way = Way()
        self._drawn = 0

    @property
    def known(self) -> bool:
        """There is a place to draw."""
        return bool(self._way.lon_lat)

    def on_position(self, position: Position, moment: Moment) -> list[Entry]:
        """The machine's place, and now and then its way; [] without a fix, or where it stands."""
        if position.quality <= 0 or not self._way.add(lat_deg=position.lat_deg, lon_deg=position.lon_deg):
            return []
        here = Ground(np.array(self._way.lon_lat[-1:])[:, ::-1], HERE_COLOR)
        entries = [Entry("/field/machine", here, moment)]
        places = len(self._way.lon_lat)
        due = places - self._drawn >= max(WAY_EVERY, WAY_GROWTH * self._drawn)
        if places >= 2 and (due or places < self._drawn or not self._drawn):
            self._drawn = places
            way = Ground(np.array(self._way.lon_lat)[:, ::-1], WAY_COLOR, way=True)
            entries.append(Entry("/field/way", way, moment, heavy=True))
        return entries

    def on_cells(self, cells: Sequence[Mapping[str, Any]], about: Mapping[str, float], moment: Moment) -> list[Entry]:
        """The yield, cell by cell, and what its colours mean."""
        corners = np.array([cell["geometry"]["coordinates"][0][:4] for cell in cells])  # (N, 4, 2) lon, lat
        side_m = float(np.median(np.ptp(corners[:, :, 1], axis=1)) * EARTH_M_PER_DEG)
        lon, lat = corners.mean(axis=1).T
        middle_deg = self._way.lon_lat[0][0] if self.known else float(lon[0])
        drawn = YieldCells(
            lat_lon_deg=np.stack([lat, beside_deg(lon, middle_deg)], axis=1),
            t_ha=_column(cells, "t_ha"),
            low_t_ha=_column(cells, "low_t_ha"),
            high_t_ha=_column(cells, "high_t_ha"),
            side_m=side_m,
        )
        told = (
            f"Yield: **{about['mean']:.1f} t/ha** in the mean, from {about['low']:.1f} (light) to {about['high']:.1f} "
            f"(dark), in {len(cells)} cells of {side_m:.0f} m."
        )
        return [Entry("/field/cells", drawn, moment, heavy=True), Entry("/field/page", Page(told), moment)]


def _column(cells: Sequence[Mapping[str, Any]], name: str) -> NDArray[np.float64]:
    return np.array([cell["properties"][name] for cell in cells], np.float64)
