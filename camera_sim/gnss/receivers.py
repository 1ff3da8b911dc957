"""Where sentences come from: a serial port, a TCP server, gpsd, a recorded file at its pace, or a simulated machine."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Protocol
from urllib.parse import parse_qs, urlsplit

from camera_sim.gnss.simulated import SimulatedReceiver, simulated_drive
from conveyor.errors import ConfigError, DeviceError, InputError
from conveyor.extras import install_hint
from conveyor.formats.nmea import MOST_BYTES, NmeaFixes

CONNECT_WITHIN_S = 5.0
POLL_S = 0.2
GPSD_PORT = 2947
GPSD_WATCH = b'?WATCH={"enable":true,"nmea":true};\n'


class Receiver(Protocol):
    """An open receiver."""

    def read(self) -> bytes | None:
        """The next line, without waiting longer than `POLL_S`; None where none came.

        Raises:
            DeviceError: it is gone.
            EOFError: a recorded file ends.
        """

    def close(self) -> None:
        """Let it go."""


def open_receiver(source: str, *, wait: Callable[[float], bool]) -> Receiver:
    """The receiver that `[gnss] source` names. `wait` sleeps for some seconds, and says True when that was interrupted.

    Raises:
        ConfigError: no such kind of source.
        DeviceError: it is not there now.
        InputError: a recorded file that cannot be read.
    """
    parts = urlsplit(source)
    if parts.scheme in ("tcp", "gpsd") and parts.hostname:
        port = parts.port or (GPSD_PORT if parts.scheme == "gpsd" else 0)
        return _Socket(parts.hostname, port, greeting=GPSD_WATCH if parts.scheme == "gpsd" else b"")
    if parts.scheme == "serial" and parts.path:
        baud = parse_qs(parts.query).get("baud", ["9600"])[0]
        return _Serial(parts.path, int(baud) if baud.isdigit() else 9600)
    if parts.scheme == "file" and parts.path:
        return _Recorded(Path(parts.path), wait=wait)
    if parts.scheme == "simulated":
        return SimulatedReceiver(simulated_drive(parts.query), wait=wait)
    raise ConfigError(
        f"gnss.source is '{source}'; allowed are serial:/dev/ttyACM0?baud=9600, tcp://host:port, gpsd://host[:port], "
        "file:PATH of recorded NMEA and simulated:?row_m=200"
    )


class _Lines:
    """Bytes put together to lines."""

    def __init__(self) -> None:
        self._buffer = b""

    def add(self, data: bytes) -> None:
        self._buffer = (self._buffer + data)[-64 * MOST_BYTES :]

    def take(self) -> bytes | None:
        line, end, rest = self._buffer.partition(b"\n")
        if not end:
            return None
        self._buffer = rest
        return line


class _Socket:
    def __init__(self, host: str, port: int, *, greeting: bytes) -> None:
        self._where = f"{host}:{port}"
        self._lines = _Lines()
        try:
            self._socket = socket.create_connection((host, port), timeout=CONNECT_WITHIN_S)
            self._socket.sendall(greeting)
            self._socket.settimeout(POLL_S)
        except OSError as error:
            raise DeviceError(f"GNSS receiver at {self._where} does not answer: {error}") from error

    def read(self) -> bytes | None:
        line = self._lines.take()
        if line is not None:
            return line
        try:
            data = self._socket.recv(4096)
        except TimeoutError:
            return None
        except OSError as error:
            raise DeviceError(f"GNSS receiver at {self._where} is gone: {error}") from error
        if not data:
            raise DeviceError(f"GNSS receiver at {self._where} closed the connection")
        self._lines.add(data)
        return self._lines.take()

    def close(self) -> None:
        with suppress(OSError):
            self._socket.close()


class _Serial:
    def __init__(self, port: str, baud: int) -> None:
        try:
            import serial
        except ImportError as error:
            raise InputError(f"a serial GNSS receiver needs pyserial; {install_hint('map')}") from error
        self._port, self._fault = port, serial.SerialException
        self._lines = _Lines()
        try:
            self._serial = serial.Serial(port, baud, timeout=POLL_S)
        except (OSError, ValueError) as error:
            raise DeviceError(f"GNSS receiver at {port} cannot be opened: {error}") from error

    def read(self) -> bytes | None:
        line = self._lines.take()
        if line is not None:
            return line
        try:
            self._lines.add(self._serial.read(max(1, self._serial.in_waiting)))
        except (OSError, self._fault) as error:
            raise DeviceError(f"GNSS receiver at {self._port} is gone: {error}") from error
        return self._lines.take()

    def close(self) -> None:
        with suppress(OSError):
            self._serial.close()


class _Recorded:
    """A file of NMEA lines, as fast as it was recorded."""

    def __init__(self, path: Path, *, wait: Callable[[float], bool]) -> None:
        try:
            self._lines: Iterator[bytes] = iter(path.read_bytes().splitlines())
        except OSError as error:
            raise InputError(f"gnss.source {path} cannot be read: {error.strerror or error}") from error
        self._wait = wait
        self._fixes = NmeaFixes()
        self._began: tuple[int, float] | None = None

    def read(self) -> bytes | None:
        line = next(self._lines, None)
        if line is None:
            raise EOFError
        fix = self._fixes.push(line)
        if fix is not None:
            fix_ns, started_s = self._began = self._began or (fix.fix_ns, time.monotonic())
            left_s = (fix.fix_ns - fix_ns) / 1e9 - (time.monotonic() - started_s)
            if left_s > 0 and self._wait(left_s):
                raise EOFError
        return line

    def close(self) -> None:
        """Nothing is open."""
