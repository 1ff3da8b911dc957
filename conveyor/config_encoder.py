"""The section [encoder] of a line's file: what tells the belt's travel to live cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from pydantic import Field, field_validator

from conveyor.config_base import Section, checked_name, serial_rate

BAUD = 115_200
SPEED_MPS = 0.4
COARSEST_M = 0.01
"""Tubers are found again within 22 mm of where they are expected: coarser pulses would lay them elsewhere each time."""


@dataclass(frozen=True, slots=True)
class SerialPort:
    """A board that sends its count: path of the port, and its rate."""

    path: str
    baud: int


@dataclass(frozen=True, slots=True)
class TcpServer:
    """The same over TCP."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class CounterFile:
    """A count of the Linux kernel: the file, or its folder."""

    path: Path


@dataclass(frozen=True, slots=True)
class SimulatedBelt:
    """No encoder: a belt that runs evenly."""

    speed_mps: float


EncoderSource = SerialPort | TcpServer | CounterFile | SimulatedBelt


def encoder_source(text: str) -> EncoderSource:
    """What `[encoder] source` names.

    Raises:
        ValueError: no such kind of source; says which there are.
    """
    try:
        parts = urlsplit(text)
        query = {key: values[0] for key, values in parse_qs(parts.query, keep_blank_values=True).items()}
        if parts.scheme == "serial" and parts.path and query.keys() <= {"baud"}:
            return SerialPort(parts.path, serial_rate(query.get("baud"), usual=BAUD))
        if parts.scheme == "tcp" and parts.hostname and parts.port and not query:
            return TcpServer(parts.hostname, parts.port)
        if parts.scheme == "counter" and parts.path and not query:
            return CounterFile(Path(parts.path))
        if parts.scheme == "simulated" and query.keys() <= {"speed_mps"}:
            return SimulatedBelt(_within(float(query.get("speed_mps", SPEED_MPS)), -3.0, 3.0))
    except ValueError:  # a port or a value that is none
        pass
    raise ValueError(
        f"'{text}' is no encoder; allowed are serial:/dev/ttyACM0?baud={BAUD}, tcp://host:port, "
        f"counter:/sys/bus/counter/devices/counter0/count0 and simulated:?speed_mps={SPEED_MPS:g}"
    )


def _within(value: float, least: float, most: float) -> float:
    if not (math.isfinite(value) and least <= value <= most):
        raise ValueError(value)
    return value


class EncoderConfig(Section):
    """The encoder on the belt's shaft. Live cameras stamp each frame with the travel that it tells."""

    source: str = Field(
        description="where its count comes from: serial:/dev/ttyACM0?baud=115200 or tcp://host:port (a line of text "
        "each time), counter:/sys/bus/counter/devices/counter0/count0 (Linux), simulated:?speed_mps=0.4"
    )
    metres_per_pulse: float = Field(
        ge=-COARSEST_M,
        le=COARSEST_M,
        description="belt that passes in one count; below 0 where it counts down while the belt runs on",
    )
    bits: int = Field(32, ge=8, le=64, description="of the counter: where it is full it begins at 0 again")
    name: str = Field("encoder", description="the encoder's name on the line")

    @field_validator("source")
    @classmethod
    def _known(cls, source: str) -> str:
        encoder_source(source)
        return source

    @field_validator("metres_per_pulse")
    @classmethod
    def _moves(cls, metres: float) -> float:
        if abs(metres) < 1e-7:
            raise ValueError("a pulse is some belt: 0.0005 is half a millimetre")
        return metres

    @field_validator("name")
    @classmethod
    def _name(cls, name: str) -> str:
        return checked_name(name, "encoder")
