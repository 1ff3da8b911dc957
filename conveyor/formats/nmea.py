"""NMEA 0183 sentences to positions, with pynmeagps; talkers GP, GN, GL, GA, GB ... alike.

A receiver tells one position in several sentences of the same time of day: GGA has place and quality, RMC has the date.
A position is given out once, when its GGA has come and the date is known.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, time, timedelta

from conveyor.errors import InputError
from conveyor.extras import missing_package

MOST_BYTES = 1024
"""No sentence is longer; what is, is noise on the line."""
HALF_DAY = timedelta(hours=12)


@dataclass(frozen=True, slots=True)
class Fix:
    """One position as the receiver told it.

    Attributes:
        fix_ns: Unix time by the receiver, nanoseconds.
        lat_deg, lon_deg: WGS84; 0, 0 where there was no fix.
        quality: as in GGA: 0 no fix, 1 GNSS, 2 differential, 4 RTK, 5 RTK float, 8 simulated.
        hdop: dilution of precision; None where it was not told. satellites: how many were used.
    """

    fix_ns: int
    lat_deg: float
    lon_deg: float
    quality: int
    hdop: float | None
    satellites: int


@dataclass(slots=True)
class NmeaFixes:
    """A stream of sentences. `refused` counts lines that were not taken, by reason."""

    refused: Counter[str] = field(default_factory=Counter)
    _date: date | None = None
    _at: time | None = None

    def push(self, line: bytes) -> Fix | None:
        """The position that this line completes; None where it completes none.

        Raises:
            InputError: pynmeagps is not installed.
        """
        if not line.strip():
            return None
        if len(line) > MOST_BYTES or not line.lstrip().startswith(b"$"):
            self.refused["not NMEA"] += 1
            return None
        message = self._parsed(line.strip() + b"\r\n")
        if message is None:
            return None
        if message.msgID in ("RMC", "ZDA"):
            self._note_date(message)
            return None
        return self._fix(message) if message.msgID == "GGA" else None

    def _parsed(self, line: bytes):  # type: ignore[no-untyped-def]
        try:
            from pynmeagps import NMEAMessageError, NMEAParseError, NMEAReader, NMEAStreamError, NMEATypeError
        except ImportError as error:
            raise InputError(missing_package(error, "pynmeagps", extra="gnss", what="a GNSS receiver")) from error
        try:
            message = NMEAReader.parse(line)
        except NMEAParseError as error:
            self.refused["checksum" if "hecksum" in str(error) else "damaged"] += 1
            return None
        except (NMEAMessageError, NMEAStreamError, NMEATypeError, ValueError, UnicodeDecodeError):
            self.refused["damaged"] += 1
            return None
        if not hasattr(message, "msgID"):
            self.refused["damaged"] += 1
            return None
        return message

    def _note_date(self, message) -> None:  # type: ignore[no-untyped-def]
        if message.msgID == "RMC" and isinstance(message.date, date):
            self._date, self._at = message.date, message.time if isinstance(message.time, time) else None
        elif message.msgID == "ZDA" and message.year and message.month and message.day:
            try:
                self._date, self._at = date(message.year, message.month, message.day), message.time or None
            except ValueError:  # a day that no month has
                self.refused["damaged"] += 1

    def _fix(self, message) -> Fix | None:  # type: ignore[no-untyped-def]
        if not isinstance(message.time, time):
            self.refused["no time"] += 1
            return None
        if self._date is None:
            self.refused["no date yet"] += 1
            return None
        at = datetime.combine(self._date, message.time, tzinfo=UTC)
        if self._at is not None:  # the date is of another second: midnight may lie between the two
            told = datetime.combine(self._date, self._at, tzinfo=UTC)
            at += (
                timedelta(days=1)
                if told - at > HALF_DAY
                else timedelta(days=-1)
                if at - told > HALF_DAY
                else timedelta()
            )
        quality = int(message.quality or 0)
        there = quality > 0 and isinstance(message.lat, float) and isinstance(message.lon, float)
        return Fix(
            fix_ns=round(at.timestamp() * 1000) * 1_000_000,
            lat_deg=float(message.lat) if there else 0.0,
            lon_deg=float(message.lon) if there else 0.0,
            quality=quality if there else 0,
            hdop=float(message.HDOP) if isinstance(message.HDOP, int | float) else None,
            satellites=int(message.numSV or 0),
        )
