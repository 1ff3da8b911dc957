"""Devices that send lines of text: over a TCP connection or a serial port."""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import Protocol

from conveyor.errors import DeviceError, InputError
from conveyor.extras import install_hint

CONNECT_WITHIN_S = 3.0
"""A unit that is stopped has 5 s."""
POLL_S = 0.2
MOST_BYTES = 65536
"""Kept of what has no end of a line, or is not taken in time."""


class LineDevice(Protocol):
    """An open device."""

    def read(self) -> bytes | None:
        """The next line, without waiting longer than `POLL_S`; None where none came.

        Raises:
            DeviceError: it is gone.
            EOFError: a recorded file ends.
        """

    @property
    def pending(self) -> bool:
        """Another line has come already."""

    def close(self) -> None:
        """Let it go."""


class _Lines:
    """Bytes put together to lines."""

    def __init__(self) -> None:
        self._buffer = b""

    def add(self, data: bytes) -> None:
        self._buffer = (self._buffer + data)[-MOST_BYTES:]

    @property
    def pending(self) -> bool:
        return b"\n" in self._buffer

    def take(self) -> bytes | None:
        line, end, rest = self._buffer.partition(b"\n")
        if not end:
            return None
        self._buffer = rest
        return line


class SocketLines:
    """A TCP server. `what` it is stands in errors; `greeting` is sent to it first.

    Raises:
        DeviceError: it does not answer.
    """

    def __init__(self, host: str, port: int, *, what: str, greeting: bytes = b"") -> None:
        self._where = f"{what} at {host}:{port}"
        self._lines = _Lines()
        try:
            self._socket = socket.create_connection((host, port), timeout=CONNECT_WITHIN_S)
            self._socket.sendall(greeting)
            self._socket.settimeout(POLL_S)
        except OSError as error:
            raise DeviceError(f"{self._where} does not answer: {error}") from error

    def read(self) -> bytes | None:
        """As `LineDevice` has it."""
        line = self._lines.take()
        if line is not None:
            return line
        try:
            data = self._socket.recv(4096)
        except TimeoutError:
            return None
        except OSError as error:
            raise DeviceError(f"{self._where} is gone: {error}") from error
        if not data:
            raise DeviceError(f"{self._where} closed the connection")
        self._lines.add(data)
        return self._lines.take()

    @property
    def pending(self) -> bool:
        """As `LineDevice` has it."""
        return self._lines.pending

    def close(self) -> None:
        """As `LineDevice` has it."""
        with suppress(OSError):
            self._socket.close()


class SerialLines:
    """A serial port. `what` is behind it stands in errors; `extra` installs what it needs.

    Raises:
        InputError: pyserial is not installed.
        DeviceError: the port cannot be opened.
    """

    def __init__(self, port: str, baud: int, *, what: str, extra: str) -> None:
        try:
            import serial
        except ImportError as error:
            raise InputError(f"a serial {what} needs pyserial; {install_hint(extra)}") from error
        self._where, self._fault = f"{what} at {port}", serial.SerialException
        self._lines = _Lines()
        try:
            self._serial = serial.Serial(port, baud, timeout=POLL_S)
        except (OSError, ValueError) as error:
            raise DeviceError(f"{self._where} cannot be opened: {error}") from error

    def read(self) -> bytes | None:
        """As `LineDevice` has it."""
        line = self._lines.take()
        if line is not None:
            return line
        try:
            self._lines.add(self._serial.read(max(1, self._serial.in_waiting)))
        except (OSError, self._fault) as error:
            raise DeviceError(f"{self._where} is gone: {error}") from error
        return self._lines.take()

    @property
    def pending(self) -> bool:
        """As `LineDevice` has it."""
        return self._lines.pending

    def close(self) -> None:
        """As `LineDevice` has it."""
        with suppress(OSError):
            self._serial.close()
