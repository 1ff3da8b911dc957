"""Where the machine is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from conveyor.messages.base import Message
from conveyor.ranges import Count, Name, Nanoseconds, Range


@dataclass(frozen=True, slots=True)
class Position(Message):
    """One position of the machine, as its GNSS receiver told it.

    `n` counts from 0 within the receiver's file. `time_ns` is the Unix time by the clock of the host it is connected
    to, the clock that stamps frames; `fix_ns` that of the receiver. WGS84 degrees. `quality` as in NMEA's GGA: 0 is
    no fix (then the degrees are 0 and mean nothing), 1 GNSS, 2 differential, 4 RTK, 5 RTK float.
    """

    receiver: Name
    run: Name
    n: Count
    time_ns: Nanoseconds
    fix_ns: Nanoseconds
    lat_deg: Annotated[float, Range(-90, 90, "degrees")]
    lon_deg: Annotated[float, Range(-180, 180, "degrees")]
    quality: Annotated[int, Range(0, 9, "")]
    hdop: Annotated[float, Range(0, 1000, "")] | None
    satellites: Annotated[int, Range(0, 1000, "")]
