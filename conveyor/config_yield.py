"""What turns tubers into yield: the sections [gnss] and [foreign] of a line's file."""

from __future__ import annotations

from urllib.parse import SplitResult, parse_qs, urlsplit

from pydantic import Field, field_validator

from conveyor.config_base import Section, checked_name, serial_rate

BAUD = 9600
CLOD_FILLED = 0.72
"""Of the volume under the visible surface of a clod or a stone, the part that is body and not the air under its flanks.
Median over those refused on simulated belts with seeds 61000 and on."""


def gnss_source(text: str) -> SplitResult:
    """The parts of what `[gnss] source` names; `baud` tells a serial port's rate.

    Raises:
        ValueError: no such kind of source; says which there are.
    """
    try:
        parts = urlsplit(text)
        known = {
            "serial": bool(parts.path) and baud(parts) > 0,
            "tcp": bool(parts.hostname and parts.port),
            "gpsd": bool(parts.hostname) and parts.port != 0,
            "file": bool(parts.path),
            "simulated": True,
        }
        if known.get(parts.scheme, False):
            return parts
    except ValueError:  # a port or a rate that is none
        pass
    raise ValueError(
        f"'{text}' is no GNSS receiver; allowed are serial:/dev/ttyACM0?baud={BAUD}, tcp://host:port, "
        "gpsd://host[:port], file:PATH of recorded NMEA and simulated:?row_m=200"
    )


def baud(port: SplitResult) -> int:
    """The rate of a serial port; raises ValueError as `serial_rate` does."""
    return serial_rate(parse_qs(port.query, keep_blank_values=True).get("baud", [None])[0], usual=BAUD)


class GnssConfig(Section):
    """The machine's GNSS receiver, and how the machine harvests: what a map of the field needs."""

    source: str = Field(
        description="serial:/dev/ttyACM0?baud=9600, tcp://host:port, gpsd://host, file:recorded.nmea or simulated:"
    )
    name: str = Field("gnss", description="the receiver's name on the line")
    width_m: float = Field(1.5, ge=0.2, le=50, description="working width of the share")
    overlap_m: float = Field(0.0, ge=0, le=5, description="by how much a pass is meant to overlap the one before")
    delay_s: float | None = Field(
        None, ge=-60, le=600, description="from ground to camera; not given: found from the yields themselves"
    )
    antenna_ahead_m: float = Field(0.0, ge=-20, le=20, description="antenna in front of the share")

    @field_validator("source")
    @classmethod
    def _known(cls, source: str) -> str:
        gnss_source(source)
        return source

    @field_validator("name")
    @classmethod
    def _name(cls, name: str) -> str:
        return checked_name(name, "receiver")


class ForeignConfig(Section):
    """What clods, stones and haulm weigh: their volume is measured, their density is not."""

    clod_density: float = Field(1.6, gt=0, le=4, description="of a clod, g/ml: 1.3 dry and loose to 1.9 wet and dense")
    stone_density: float = Field(2.6, gt=0, le=4, description="of a stone, g/ml")
    haulm_density: float = Field(0.3, ge=0, le=2, description="of what lies under the surface of haulm, g/ml, with air")
    stone_share: float = Field(
        0.3, ge=0, le=1, description="stones among clods and stones, by volume: depth does not tell them apart"
    )
