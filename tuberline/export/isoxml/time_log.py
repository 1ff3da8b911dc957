"""The binary time log of ISO 11783-10 (TLG): a header in XML says which values each record of the .BIN file holds.

A record is: milliseconds since midnight (uint32), days since 1980-01-01 (uint16), those attributes of the position
that the header leaves empty, the number of values (uint8), and each as its index in the header (uint8) and an int32.
What the header gives a value is the same in all records and not repeated.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from xml.etree import ElementTree

from conveyor.errors import InputError

EPOCH = datetime(1980, 1, 1, tzinfo=UTC)
LAST_DAY = 65_535
"""After the epoch, as a uint16 holds it: in the year 2159."""
INT32 = (-(1 << 31), (1 << 31) - 1)
DEGREES = 1e-7
GNSS_FIX = 1
"""The status of a position that has no correction (ISO 11783-10, PTN)."""
_POSITION = {
    "A": ("north", "i", DEGREES),
    "B": ("east", "i", DEGREES),
    "C": ("up_m", "i", 0.001),
    "D": ("status", "B", 1),
    "E": ("pdop", "H", 0.1),
    "F": ("hdop", "H", 0.1),
    "G": ("satellites", "B", 1),
    "H": ("utc_ms", "I", 1),
    "I": ("utc_days", "H", 1),
}
"""Attributes of PTN in their order in a record: name, how it is packed, its unit."""


@dataclass(frozen=True, slots=True)
class LoggedValue:
    """A column of the log: `ddi` of the ISO 11783-11 dictionary, and the device element it belongs to."""

    ddi: int
    element: str


@dataclass(frozen=True, slots=True)
class LogRecord:
    """One moment: UTC, degrees (None: no position in this log), and raw int32 values by column."""

    time: datetime
    lat_deg: float | None
    lon_deg: float | None
    values: dict[LoggedValue, int] = field(default_factory=dict)


def header_xml(values: Sequence[LoggedValue]) -> bytes:
    """The header of a log with a position (north, east, status) and `values` in each record."""
    time = ElementTree.Element("TIM", A="", D="4")
    ElementTree.SubElement(time, "PTN", A="", B="", D="")
    for value in values:
        ElementTree.SubElement(time, "DLV", A=f"{value.ddi:04X}", B="", C=value.element)
    ElementTree.indent(time)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(time) + b"\n"


def pack_records(records: Sequence[LogRecord], values: Sequence[LoggedValue]) -> bytes:
    """The .BIN file for `header_xml(values)`.

    Raises:
        InputError: a value that an int32 cannot hold, a record without a position, or of before 1980 or after 2159.
    """
    index = {value: n for n, value in enumerate(values)}
    out = bytearray()
    for record in records:
        if record.lat_deg is None or record.lon_deg is None:
            raise InputError(f"time log: the record of {record.time} has no position")
        since = record.time - EPOCH
        if not 0 <= since.days <= LAST_DAY:
            raise InputError(
                f"time log: a record is of {record.time:%Y-%m-%d}, a log holds {EPOCH:%Y-%m-%d} to "
                f"{EPOCH + timedelta(days=LAST_DAY):%Y-%m-%d}: was the clock set that stamped it?"
            )
        place = (round(record.lat_deg / DEGREES), round(record.lon_deg / DEGREES), GNSS_FIX)
        ms = since % timedelta(days=1) // timedelta(milliseconds=1)
        out += struct.pack("<IHiiBB", ms, since.days, *place, len(record.values))
        for value, number in record.values.items():
            if not INT32[0] <= number <= INT32[1]:
                raise InputError(f"time log: {number} of DDI {value.ddi} does not fit 32 bits")
            out += struct.pack("<Bi", index[value], number)
    return bytes(out)


def unpack_records(header: bytes, data: bytes, *, where: str) -> list[LogRecord]:
    """All records of a time log, of any terminal.

    Args:
        where: named in errors.

    Raises:
        InputError: a header that is none, or a log that ends within a record or holds what its header does not tell.
    """
    position, fixed, values = _read_header(header, where)
    records: list[LogRecord] = []
    at = 0
    try:
        while at < len(data):
            ms, days = struct.unpack_from("<IH", data, at)
            at += 6
            place = dict(fixed)
            for name, kind, unit in position:
                (number,) = struct.unpack_from(f"<{kind}", data, at)
                at += struct.calcsize(f"<{kind}")
                place[name] = round(number * unit, 7)
            (count,) = struct.unpack_from("<B", data, at)
            at += 1
            found = {}
            for _ in range(count):
                n, number = struct.unpack_from("<Bi", data, at)
                at += 5
                if n >= len(values):
                    raise InputError(f"{where}: record {len(records)} has a value {n}, its header names {len(values)}")
                found[values[n]] = number
            time = EPOCH + timedelta(days=days, milliseconds=ms)
            records.append(LogRecord(time, place.get("north"), place.get("east"), found))
    except struct.error as error:
        raise InputError(f"{where} ends within record {len(records)}, at byte {len(data)}: it is cut short") from error
    return records


def _read_header(header: bytes, where: str) -> tuple[list[tuple[str, str, float]], dict[str, float], list[LoggedValue]]:
    """(attributes in each record, those that are the same in all, columns)."""
    try:
        root = ElementTree.fromstring(header)
    except ElementTree.ParseError as error:
        raise InputError(f"{where}: its header is no XML: {error}") from error
    time = root if root.tag == "TIM" else root.find("TIM")
    if time is None:
        raise InputError(f"{where}: its header has no TIM")
    position, fixed = [], {}
    point = time.find("PTN")
    if point is not None:
        for name, (told, kind, unit) in _POSITION.items():
            given = point.get(name)
            if given == "":
                position.append((told, kind, unit))
            elif given is not None and told in ("north", "east"):
                fixed[told] = _degrees(given, where)
    try:
        values = [LoggedValue(int(value.get("A", ""), 16), value.get("C", "")) for value in time.findall("DLV")]
    except ValueError as error:
        raise InputError(f"{where}: a DLV of its header has no DDI: {error}") from error
    return position, fixed, values


def _degrees(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise InputError(f"{where}: the PTN of its header is at '{text}', which is no number") from error
