"""Where an encoder's count comes from: lines of text by a serial port or TCP, Linux counters, a simulated belt."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from camera_sim.lines import LineDevice, SerialLines, SocketLines
from conveyor.config_encoder import (
    CounterFile,
    EncoderConfig,
    SerialPort,
    SimulatedBelt,
    TcpServer,
    encoder_source,
)
from conveyor.errors import DeviceError

WHAT = "encoder"
READ_EVERY_S = 0.02
LONGEST_LINE = 80
_COUNT = re.compile(rb"[^\d+-]*([+-]?\d{1,20})\s*")


class Counter(Protocol):
    """An open encoder."""

    def read(self) -> int | None:
        """Its count now, or the next one that it sends, without waiting longer than `camera_sim.lines.POLL_S`; None
        where none came.

        Raises:
            DeviceError: it is gone.
            ValueError: what came is no count; says what it was.
        """

    def close(self) -> None:
        """Let it go."""


def open_counter(settings: EncoderConfig, *, wait: Callable[[float], bool]) -> Counter:
    """The encoder that `[encoder] source` names. `wait` sleeps for some seconds, and says True when interrupted.

    Raises:
        DeviceError: it is not there now.
        InputError: a package is missing.
    """
    source = encoder_source(settings.source)
    match source:
        case TcpServer():
            return _Told(SocketLines(source.host, source.port, what=WHAT))
        case SerialPort():
            return _Told(SerialLines(source.path, source.baud, what=WHAT, extra="encoder"))
        case CounterFile():
            return _Files(source.path, wait=wait)
        case SimulatedBelt():
            return _Simulated(source.speed_mps / settings.metres_per_pulse, wait=wait)


def count_of(line: bytes) -> int:
    """The count that a line of text ends with: '12345', 'count=-7'.

    Raises:
        ValueError: it has none; says what it was.
    """
    found = _COUNT.fullmatch(line) if len(line) <= LONGEST_LINE else None
    if found is None:
        raise ValueError(f"no count in the line {line[:LONGEST_LINE]!r}")
    return int(found.group(1))


class _Told:
    """A device that sends its count as a line of text."""

    def __init__(self, device: LineDevice) -> None:
        self._device = device

    def read(self) -> int | None:
        line = self._device.read()
        while self._device.pending:  # a port hands over many at once, and only the newest is of now
            line = self._device.read()
        return None if line is None or not line.strip() else count_of(line)

    def close(self) -> None:
        self._device.close()


class _Files:
    """A count of the kernel's counter subsystem; its file `count`, read again and again."""

    def __init__(self, path: Path, *, wait: Callable[[float], bool]) -> None:
        self._path = path if path.name == "count" else path / "count"
        self._wait = wait
        self._text()

    def read(self) -> int | None:
        if self._wait(READ_EVERY_S):
            return None
        return count_of(self._text())

    def _text(self) -> bytes:
        try:
            return self._path.read_bytes().strip()
        except OSError as error:
            raise DeviceError(f"{WHAT} at {self._path} cannot be read: {error.strerror or error}") from error

    def close(self) -> None:
        """Nothing is open."""


class _Simulated:
    """The shaft of a belt that runs evenly."""

    def __init__(self, pulses_per_s: float, *, wait: Callable[[float], bool]) -> None:
        self._pulses_per_s, self._wait = pulses_per_s, wait
        self._began_s = time.monotonic()

    def read(self) -> int | None:
        if self._wait(READ_EVERY_S):
            return None
        return round((time.monotonic() - self._began_s) * self._pulses_per_s)

    def close(self) -> None:
        """Nothing is open."""
