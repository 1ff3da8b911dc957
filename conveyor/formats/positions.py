"""Files of a machine's positions: our own positions.csv, and what others write: CSV, NMEA logs, GPX.

Our own file has one row per position, added and synced one by one, each with the CRC-32 of what stands before it; a
last row that a power cut left half-written is left out, and damage anywhere else is an error.
"""

from __future__ import annotations

import csv
import io
import math
import os
import zlib
from codecs import BOM_UTF8
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Self
from xml.etree import ElementTree

from conveyor.errors import InputError, StorageError
from conveyor.files import told
from conveyor.formats.nmea import NmeaFixes
from conveyor.messages import Position

POSITIONS_FILE = "positions.csv"
COLUMNS = ("n", "time_ns", "fix_ns", "lat_deg", "lon_deg", "quality", "hdop", "satellites", "crc")
MOST_QUALITY = 9
LAST_NS = 2**63 - 1
"""The year 2262: no time is later, and milliseconds taken for seconds are."""
SEPARATORS = (",", ";", "\t")
"""Of columns: the one that the header has most of."""
MOSTLY = 0.9
NOT_TAKEN = {
    "not NMEA": "in a line that does not begin as NMEA does",
    "checksum": "with a wrong checksum",
    "damaged": "in a damaged line",
    "no time": "without a time of day",
    "no date yet": "before any date, which RMC or ZDA tell",
}
"""Why a position of an NMEA log is not taken, by what `NmeaFixes` counts."""
_NO_GGA = "no sentence GGA, which tells one, is in it"
_BEYOND = "beyond the header"
_TOO_MANY = "it has more values than the header has names; numbers with decimal commas need ; between them, or quotes"
_LATITUDE = ("lat_deg", "lat", "latitude")
_LONGITUDE = ("lon_deg", "lon", "long", "lng", "longitude")
_TIME = ("time_ns", "time_s", "time", "timestamp", "datetime", "utc")


@dataclass(frozen=True, slots=True)
class Place:
    """One row of a track: Unix time in nanoseconds, WGS84 degrees, quality as in NMEA's GGA (0: no fix).

    Our own files also tell the receiver's time, its dilution of precision and its satellites, as `Position` does.
    """

    time_ns: int
    lat_deg: float
    lon_deg: float
    quality: int
    fix_ns: int | None = None
    hdop: float | None = None
    satellites: int = 0


def read_positions(path: Path, *, refused: Counter[str] | None = None) -> list[Place]:
    """All positions of a file, in its order; of positions.csv as it was written, of others by their columns. A table
    or a GPX file that goes back in time, the newest first, is read from its end.

    Args:
        refused: is added to by how many positions of an NMEA log were not taken, by reason.

    Raises:
        InputError: not readable, no known format, damaged, or no position in it.
    """
    refused = Counter() if refused is None else refused
    try:
        data = path.read_bytes().removeprefix(BOM_UTF8)  # which spreadsheets of Windows write
    except OSError as error:
        raise InputError(f"track {told(error, path)}") from error
    nmea = data.lstrip()[:1] == b"$"
    if path.suffix.lower() == ".gpx" or data.lstrip()[:5] == b"<?xml" or data.lstrip()[:4] == b"<gpx":
        places = _forward(_gpx(data, path))
    elif nmea:
        places = list(_nmea(data, refused))
    else:
        try:
            places = _forward(_table(data, path))
        except csv.Error as error:
            raise InputError(f"track {path} is not CSV text: {error}") from error
    if not places:
        why = ", ".join(f"{n} {reason}" for reason, n in refused.most_common()) or (_NO_GGA if nmea else "")
        raise InputError(f"track {path} holds no position{f': {why}' if why else ''}")
    return places


def _forward(places: Iterable[Place]) -> list[Place]:
    """The oldest first, where nearly all go back in time; a clock that was set back in between is left as it is."""
    found = list(places)
    back = sum(after.time_ns < before.time_ns for before, after in pairwise(found))
    return found[::-1] if back > MOSTLY * (len(found) - 1) else found


class PositionsWriter:
    """positions.csv of a run, added to by one process. Use as a context manager."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> Self:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self.rows = _whole_rows(self._path) if self._path.exists() else 0
            self._file = self._path.open("ab")
            if self._file.tell() == 0:
                self._add(",".join(COLUMNS))
        except OSError as error:
            raise StorageError(f"positions {told(error, self._path)}") from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(OSError):  # of a row that `write` has told of; closing tries it once more
            self._file.close()

    def write(self, values: Iterable[object]) -> None:
        """Add one row, `COLUMNS` without n and crc, durably.

        Raises:
            StorageError: the disk is full or reports an error.
        """
        text = ",".join(str("" if value is None else value) for value in (self.rows, *values))
        try:
            self._add(f"{text},{zlib.crc32(text.encode())}")
        except OSError as error:
            raise StorageError(f"positions {told(error, self._path)}") from error
        self.rows += 1

    def add(self, at: Position) -> None:
        """Add a position of the line, as `write` does."""
        self.write(getattr(at, name) for name in COLUMNS[1:-1])

    def _add(self, line: str) -> None:
        self._file.write(line.encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())


def _whole_rows(path: Path) -> int:
    """How many rows the file holds; a last one that is not whole is cut off."""
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    if whole < len(data):
        with path.open("r+b") as file:
            file.truncate(whole)
    return max(data.count(b"\n") - 1, 0)


def _table(data: bytes, path: Path) -> Iterator[Place]:
    text = data.decode("utf-8", errors="replace")
    whole = text[: text.rfind("\n") + 1] if text.startswith(",".join(COLUMNS)) else text
    lines = io.StringIO(whole, newline=None)
    head = lines.readline()
    lines.seek(0)
    rows = csv.DictReader(lines, delimiter=max(SEPARATORS, key=head.count), restkey=_BEYOND)
    names = {name.strip().lower(): name for name in rows.fieldnames or () if name}
    found = [next((names[name] for name in known if name in names), None) for known in (_TIME, _LATITUDE, _LONGITUDE)]
    if None in found:
        raise InputError(
            f"track {path} has the columns {', '.join(names) or 'none'}; needed are a time ({', '.join(_TIME)}), a "
            f"latitude ({', '.join(_LATITUDE)}) and a longitude ({', '.join(_LONGITUDE)}), or a GPX or NMEA file"
        )
    time, lat, lon = (str(name) for name in found)
    for number, row in enumerate(rows, start=2):
        if "crc" in names:
            _check(row, path, number)
        try:
            if any(row.pop(_BEYOND, None) or ()):
                raise ValueError(_TOO_MANY)
            if None in row.values():
                raise ValueError(f"it has fewer values than the header has names: {', '.join(names)}")
            quality = int(float(row[names["quality"]] or 0)) if "quality" in names else 1
            told = _told(row) if "crc" in names else (None, None, 0)
            time_ns = _time_ns(row[time], time.strip().lower())
            place = _within(Place(time_ns, _number(row[lat]), _number(row[lon]), quality, *told))
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(f"track {path}, line {number}: {error}") from error
        yield place


def _number(text: str) -> float:
    """A number with a decimal point, or a decimal comma as spreadsheets of many countries write it.

    Raises:
        ValueError: none; one with a point and a comma, which may be thousands, is refused.
    """
    try:
        return float(text.replace(",", ".") if text.count(",") == 1 and "." not in text else text)
    except ValueError as error:
        raise ValueError(f"'{text}' is no number; give one with a decimal point or comma and nothing else") from error


def _within(place: Place) -> Place:
    """The place, if it can be one on Earth; a logger's NaN before its first fix is no fix.

    Raises:
        ValueError: it cannot; the text says which value is off.
    """
    if math.isnan(place.lat_deg) or math.isnan(place.lon_deg):
        place = replace(place, lat_deg=0.0, lon_deg=0.0, quality=0)
    if not 0 <= place.time_ns <= LAST_NS:
        raise ValueError(f"its time lies {place.time_ns / 1e9:g} s after 1970; give seconds, or ISO 8601")
    for what, value, most in (("latitude", place.lat_deg, 90), ("longitude", place.lon_deg, 180)):
        if not -most <= value <= most:
            raise ValueError(f"its {what} is {value:g}; allowed are -{most} to {most}, decimal degrees")
    if not 0 <= place.quality <= MOST_QUALITY:
        raise ValueError(f"its quality is {place.quality}; allowed are 0 (no fix) to {MOST_QUALITY}, as in NMEA's GGA")
    return place


def _check(row: dict[str, str], path: Path, number: int) -> None:
    text = ",".join(row.get(name) or "" for name in COLUMNS[:-1])
    if str(zlib.crc32(text.encode())) != row.get("crc"):
        raise InputError(f"track {path}, line {number} is damaged: its checksum is not that of its values")


def _told(row: dict[str, str]) -> tuple[int, float | None, int]:
    """What only our own file has of the receiver."""
    return int(row["fix_ns"]), float(row["hdop"]) if row["hdop"] else None, int(row["satellites"])


def _time_ns(text: str, column: str) -> int:
    """Nanoseconds, seconds or ISO 8601, by the column's name and the value."""
    if column == "time_ns":
        return int(text)
    try:
        return round(_number(text) * 1000) * 1_000_000
    except ValueError:
        try:
            at = datetime.fromisoformat(text.strip())
        except ValueError as error:
            raise ValueError(f"its time is '{text}'; give Unix seconds, or ISO 8601: 2026-09-21T14:13:20Z") from error
        return round((at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp() * 1000) * 1_000_000


def _nmea(data: bytes, refused: Counter[str]) -> Iterator[Place]:
    """`refused` counts the positions that were not taken; what is refused of other sentences is none."""
    fixes = NmeaFixes()
    for line in data.splitlines():
        before = fixes.refused.copy()
        fix = fixes.push(line)
        if b"GGA" in line:
            refused.update(NOT_TAKEN[why] for why in fixes.refused - before)
        if fix is not None:
            yield Place(fix.fix_ns, fix.lat_deg, fix.lon_deg, fix.quality)


def _gpx(data: bytes, path: Path) -> Iterator[Place]:
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise InputError(f"track {path} is no GPX file: {error}") from error
    for point in root.iter():
        if point.tag.rpartition("}")[2] != "trkpt":
            continue
        at = next((part.text for part in point if part.tag.rpartition("}")[2] == "time"), None)
        if at is None:
            raise InputError(f"track {path}: a trkpt has no time; a map needs one for each position")
        try:
            place = Place(_time_ns(at, "time"), float(point.get("lat", "")), float(point.get("lon", "")), 1)
            place = _within(place)
        except (ValueError, OverflowError) as error:
            raise InputError(f"track {path}: {error}") from error
        yield place
