"""Where sentences come from: a serial port, a TCP server, gpsd, a recorded file at its pace, or a simulated machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import SplitResult

from camera_sim.gnss.simulated import SimulatedReceiver, simulated_drive
from camera_sim.lines import LineDevice, SerialLines, SocketLines
from conveyor.config_yield import baud, gnss_source
from conveyor.errors import ConfigError, InputError
from conveyor.files import cause
from conveyor.formats.nmea import NmeaFixes

WHAT = "GNSS receiver"
GPSD_PORT = 2947
GPSD_WATCH = b'?WATCH={"enable":true,"nmea":true};\n'


def open_receiver(source: str, *, wait: Callable[[float], bool]) -> LineDevice:
    """The receiver that `[gnss] source` names. `wait` sleeps for some seconds, and says True when that was interrupted.

    Raises:
        ConfigError: no such kind of source.
        DeviceError: it is not there now.
        InputError: a recorded file that cannot be read.
    """
    parts = _parts(source)
    if parts.scheme in ("tcp", "gpsd"):
        greeting = GPSD_WATCH if parts.scheme == "gpsd" else b""
        return SocketLines(parts.hostname or "", parts.port or GPSD_PORT, what=WHAT, greeting=greeting)
    if parts.scheme == "serial":
        return SerialLines(parts.path, baud(parts), what=WHAT, extra="gnss")
    if parts.scheme == "file":
        return _Recorded(Path(parts.path), wait=wait)
    return SimulatedReceiver(simulated_drive(parts.query), wait=wait)


def check_receiver(source: str) -> None:
    """What can be told of a source without opening a device.

    Raises:
        ConfigError: no such kind of source, or no such drive.
        InputError: a recorded file that cannot be read.
    """
    parts = _parts(source)
    if parts.scheme == "file":
        _recorded(Path(parts.path))
    elif parts.scheme == "simulated":
        simulated_drive(parts.query)


def _parts(source: str) -> SplitResult:
    try:
        return gnss_source(source)
    except ValueError as error:
        raise ConfigError(f"gnss.source: {error}") from error


def _recorded(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"gnss.source {path} cannot be read: {cause(error)}") from error


class _Recorded:
    """A file of NMEA lines, as fast as it was recorded."""

    def __init__(self, path: Path, *, wait: Callable[[float], bool]) -> None:
        self._lines: Iterator[bytes] = iter(_recorded(path).splitlines())
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
                return None
        return line

    @property
    def pending(self) -> bool:
        """Each line waits for its time."""
        return False

    def close(self) -> None:
        """Nothing is open."""
