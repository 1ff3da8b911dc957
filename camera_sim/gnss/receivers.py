"""Where sentences come from: a serial port, a TCP server, gpsd, a recorded file at its pace, or a simulated machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from camera_sim.gnss.simulated import SimulatedReceiver, simulated_drive
from camera_sim.lines import LineDevice, SerialLines, SocketLines
from conveyor.errors import ConfigError, InputError
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
    parts = urlsplit(source)
    if parts.scheme in ("tcp", "gpsd") and parts.hostname:
        port = parts.port or (GPSD_PORT if parts.scheme == "gpsd" else 0)
        return SocketLines(parts.hostname, port, what=WHAT, greeting=GPSD_WATCH if parts.scheme == "gpsd" else b"")
    if parts.scheme == "serial" and parts.path:
        baud = parse_qs(parts.query).get("baud", ["9600"])[0]
        return SerialLines(parts.path, int(baud) if baud.isdigit() else 9600, what=WHAT, extra="gnss")
    if parts.scheme == "file" and parts.path:
        return _Recorded(Path(parts.path), wait=wait)
    if parts.scheme == "simulated":
        return SimulatedReceiver(simulated_drive(parts.query), wait=wait)
    raise ConfigError(
        f"gnss.source is '{source}'; allowed are serial:/dev/ttyACM0?baud=9600, tcp://host:port, gpsd://host[:port], "
        "file:PATH of recorded NMEA and simulated:?row_m=200"
    )


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

    @property
    def pending(self) -> bool:
        """Each line waits for its time."""
        return False

    def close(self) -> None:
        """Nothing is open."""
