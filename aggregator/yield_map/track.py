"""A machine's positions over time, and which of them can be believed."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aggregator.yield_map.no_map import NoMapError, WhyNoMap
from conveyor.errors import InputError

MOST_SPEED_M_S = 12.0
"""A harvester is slower, on the road too: what lies farther from the last good position than this allows has jumped."""
LONGEST_GAP_S = 6.0
"""Positions farther apart in time are not joined: where the machine was in between is not known."""


class PositionFault(StrEnum):
    """Why a position is not used."""

    NO_FIX = "no fix"
    TIME = "time stands still or goes back"
    JUMP = "jumps farther than the machine can drive"


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Positions as a receiver told them, in the order they came.

    Attributes:
        time_ns: (N,) int64, Unix time in nanoseconds, by the clock that stamps the cameras' frames.
        lat_deg, lon_deg: (N,) float64, WGS84.
        quality: (N,) uint8, as in NMEA's GGA: 0 no fix, 1 GNSS, 2 differential, 4 RTK, 5 RTK float.
    """

    time_ns: NDArray[np.int64]
    lat_deg: NDArray[np.float64]
    lon_deg: NDArray[np.float64]
    quality: NDArray[np.uint8]

    def __post_init__(self) -> None:
        sizes = {len(self.time_ns), len(self.lat_deg), len(self.lon_deg), len(self.quality)}
        if len(sizes) != 1:
            raise InputError(f"a track needs as many times as positions, got {sorted(sizes)}")

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """The believed part of a track in the metres of its field: x east, y north of the field's origin.

    Attributes:
        time_s: (N,) float64, strictly increasing, seconds since Unix time 0.
        xy_m: (N, 2) float64.
        speed_m_s: (N,) float64, over two seconds around each position.
        heading_rad: (N,) float64, of the way driven, anticlockwise from east; kept while the machine stands.
        faults: how many positions were not used, by reason.
    """

    time_s: NDArray[np.float64]
    xy_m: NDArray[np.float64]
    speed_m_s: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    faults: dict[str, int]

    def at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """(M, 2) positions at `time_s`, linear in between; NaN before, after and within gaps of the track."""
        x, y = (np.interp(time_s, self.time_s, self.xy_m[:, axis]) for axis in (0, 1))
        return np.where(self.known(time_s)[:, None], np.stack([x, y], axis=1), np.nan)

    def heading_at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """(M,) heading at `time_s`, of the nearest earlier position."""
        return self.heading_rad[np.clip(np.searchsorted(self.time_s, time_s, "right") - 1, 0, None)]

    def known(self, time_s: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(M,) whether the machine's place is known then."""
        after = np.clip(np.searchsorted(self.time_s, time_s), 1, len(self.time_s) - 1)
        near = self.time_s[after] - self.time_s[after - 1] <= LONGEST_GAP_S
        inside = (time_s >= self.time_s[0]) & (time_s <= self.time_s[-1])
        known: NDArray[np.bool_] = near & inside
        return known


@dataclass(frozen=True, slots=True)
class FieldPlane:
    """A field's own metres: azimuthal equidistant around an origin, true within millimetres over kilometres."""

    lat_deg: float
    lon_deg: float

    def to_metres(self, lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N, 2) metres east and north of the origin."""
        return np.stack(self._projection()(lon_deg, lat_deg), axis=1)

    def to_degrees(self, xy_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Latitudes and longitudes of (N, 2) metres."""
        lon_deg, lat_deg = self._projection()(xy_m[:, 0], xy_m[:, 1], inverse=True)
        return lat_deg, lon_deg

    def _projection(self) -> Any:
        from conveyor.extras import install_hint

        try:
            from pyproj import Proj
        except ImportError as error:
            raise InputError(f"maps need pyproj, which is not installed; {install_hint('map')}") from error
        return Proj(proj="aeqd", lat_0=self.lat_deg, lon_0=self.lon_deg, datum="WGS84", units="m")


def plane_of(track: Track) -> FieldPlane:
    """The plane around the median of a track's fixes.

    Raises:
        InputError: it has no fix at all.
    """
    fixed = track.quality > 0
    if not fixed.any():
        raise NoMapError(
            f"the track has {len(track)} positions and no fix among them: nothing can be placed on a map",
            why=WhyNoMap.NO_FIX,
        )
    lat_deg, lon_deg = track.lat_deg[fixed], track.lon_deg[fixed]
    middle_deg = float(np.median(lon_deg))
    if np.ptp(lon_deg) > 180:  # a field on the 180th meridian, whose middle is not at Greenwich
        middle_deg = (float(np.median(lon_deg % 360)) + 180) % 360 - 180
    return FieldPlane(float(np.median(lat_deg)), middle_deg)


def believed(track: Track, plane: FieldPlane) -> Path:
    """The path of a track: positions without a fix, without progress in time, or too far away are left out and counted.

    A jump is judged against the last believed position and the time since, so that a receiver which really is
    elsewhere after an outage is believed again. Where more positions follow each other elsewhere than were believed
    before them, those before were the jump: a receiver's first word is often where it was switched off.

    Raises:
        InputError: fewer than two positions are left.
    """
    xy_m = plane.to_metres(track.lat_deg, track.lon_deg)
    time_s = track.time_ns / 1e9
    kept, unused = _kept(track, time_s, xy_m)
    faults = Counter(str(fault) for fault in unused.values())
    if len(kept) < 2:
        told = ", ".join(f"{n} {name}" for name, n in faults.items())
        raise NoMapError(
            f"the track has {len(kept)} usable of {len(track)} positions ({told}); a map needs two",
            why=WhyNoMap.NO_FIX,
        )
    return _path(time_s[kept], xy_m[kept], dict(faults))


def _kept(
    track: Track, time_s: NDArray[np.float64], xy_m: NDArray[np.float64]
) -> tuple[list[int], dict[int, PositionFault]]:
    """(which positions are believed, in their order; why the others are not)."""
    kept: list[int] = []
    elsewhere: list[int] = []  # the newest that follow each other, and not what is believed
    unused: dict[int, PositionFault] = {}
    for i in range(len(track)):
        fault = _fault(track, time_s, xy_m, i, kept[-1] if kept else None)
        if fault is None:
            kept.append(i)
            elsewhere = []
            continue
        unused[i] = fault
        if fault is PositionFault.NO_FIX:
            continue
        if elsewhere and _fault(track, time_s, xy_m, i, elsewhere[-1]) is not None:
            elsewhere = []
        elsewhere.append(i)
        if len(elsewhere) > len(kept):
            unused |= dict.fromkeys(kept, unused[elsewhere[0]])
            for n in elsewhere:
                del unused[n]
            kept, elsewhere = elsewhere, []
    return kept, unused


def _fault(
    track: Track, time_s: NDArray[np.float64], xy_m: NDArray[np.float64], i: int, last: int | None
) -> PositionFault | None:
    if track.quality[i] == 0 or not np.isfinite(xy_m[i]).all():
        return PositionFault.NO_FIX
    if last is None:
        return None
    step_s = time_s[i] - time_s[last]
    if step_s <= 0:
        return PositionFault.TIME
    return PositionFault.JUMP if np.hypot(*(xy_m[i] - xy_m[last])) > MOST_SPEED_M_S * max(step_s, 0.2) else None


def _path(time_s: NDArray[np.float64], xy_m: NDArray[np.float64], faults: dict[str, int]) -> Path:
    def at(times: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([np.interp(times, time_s, xy_m[:, axis]) for axis in (0, 1)], axis=1)

    early, late = np.maximum(time_s - 1, time_s[0]), np.minimum(time_s + 1, time_s[-1])
    way_m = at(late) - at(early)
    speed_m_s = np.hypot(way_m[:, 0], way_m[:, 1]) / np.maximum(late - early, 1e-3)
    heading = np.arctan2(way_m[:, 1], way_m[:, 0])
    moving = np.flatnonzero(speed_m_s > 0.2)
    if len(moving):  # while it stands, noise has a heading of its own
        heading = heading[moving[np.clip(np.searchsorted(moving, np.arange(len(heading)), "right") - 1, 0, None)]]
    return Path(time_s, xy_m, speed_m_s, heading, faults)
