"""A receiver that is not there: a machine that drives rows up and down, told as NMEA at the pace of this host's clock.

For trying out the map and its page, and for a line without a field.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from urllib.parse import parse_qsl

from conveyor.errors import ConfigError
from conveyor.geometry import EARTH_M_PER_DEG

_DEGREES = {"lat": (-80.0, 80.0), "lon": (-179.0, 179.0)}


@dataclass(frozen=True, slots=True)
class Drive:
    """Rows run north from (`lat`, `lon`), degrees, each `width_m` east of the one before; metres and seconds."""

    row_m: float = 200.0
    width_m: float = 1.5
    speed_mps: float = 1.4
    turn_s: float = 15.0
    hz: float = 1.0
    lat: float = 52.7
    lon: float = 5.75

    def at(self, seconds: float) -> tuple[float, float]:
        """(latitude, longitude) so long after the start: along a row, then slowly over to the next one."""
        row_s = self.row_m / self.speed_mps
        row, within_s = divmod(seconds, row_s + self.turn_s)
        along_m = min(within_s, row_s) * self.speed_mps
        aside_m = self.width_m * (row + max(0.0, within_s - row_s) / self.turn_s)
        north_m = along_m if row % 2 == 0 else self.row_m - along_m
        east_deg = aside_m / (EARTH_M_PER_DEG * math.cos(math.radians(self.lat)))
        return self.lat + north_m / EARTH_M_PER_DEG, self.lon + east_deg


def simulated_drive(query: str) -> Drive:
    """The drive of `simulated:?row_m=200&speed_mps=1.4`.

    Raises:
        ConfigError: no such key, or a value that is none.
    """
    drive = Drive()
    known = [field.name for field in fields(Drive)]
    for key, text in parse_qsl(query, keep_blank_values=True):
        least, most = _DEGREES.get(key, (0.01, 10_000.0))
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if key not in known or not least <= value <= most:
            raise ConfigError(
                f"gnss.source: {key}={text}; allowed are {', '.join(known)}, {key if key in known else 'each'} from "
                f"{least:g} to {most:g}"
            )
        drive = replace(drive, **{key: value})
    return drive


class SimulatedReceiver:
    """GGA and RMC of a `Drive`, quality 8 (simulated)."""

    def __init__(self, drive: Drive, *, wait: Callable[[float], bool]) -> None:
        self._drive, self._wait = drive, wait
        self._started_s = time.monotonic()
        self._told = 0
        self._next: list[bytes] = []

    def read(self) -> bytes | None:
        """The next sentence; waits for its time as a port does."""
        if not self._next:
            due_s = self._told / self._drive.hz
            left_s = due_s - (time.monotonic() - self._started_s)
            if left_s > 0 and self._wait(left_s):
                return None
            self._told += 1
            self._next = sentences(*self._drive.at(due_s), datetime.now(UTC))
        return self._next.pop(0)

    @property
    def pending(self) -> bool:
        """The second sentence of a position."""
        return bool(self._next)

    def close(self) -> None:
        """Nothing is open."""


def sentences(lat: float, lon: float, at: datetime) -> list[bytes]:
    """RMC and GGA of one position."""
    clock, place = f"{at:%H%M%S}.{at.microsecond // 10000:02d}", f"{_nmea(lat, 2, 'NS')},{_nmea(lon, 3, 'EW')}"
    return [
        _closed(f"GNRMC,{clock},A,{place},2.7,0.0,{at:%d%m%y},,,S"),
        _closed(f"GNGGA,{clock},{place},8,12,0.8,0.0,M,0.0,M,,"),
    ]


def _nmea(degrees: float, digits: int, signs: str) -> str:
    whole, minutes = divmod(round(abs(degrees) * 60, 6), 60)
    return f"{int(whole):0{digits}d}{minutes:09.6f},{signs[degrees < 0]}"


def _closed(body: str) -> bytes:
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode()
