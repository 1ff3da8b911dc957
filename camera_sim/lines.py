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


class _Port:
    """Bytes as they come, put together to lines."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._buffer = b""

    def read(self) -> bytes | None:
        """As `LineDevice` has it."""
        if not self.pending:
            self._buffer = (self._buffer + self._receive())[-MOST_BYTES:]
        line, end, rest = self._buffer.partition(b"\n")
        if not end:
            return None
        self._buffer = rest
        return line

    @property
    def pending(self) -> bool:
        """As `LineDevice` has it."""
        return b"\n" in self._buffer

    def _receive(self) -> bytes:
        """What has come, or comes within `POLL_S`; empty where nothing does."""
        raise NotImplementedError


class SocketLines(_Port):
    """A TCP server. `what` it is stands in errors; `greeting` is sent to it first.

    Raises:
        DeviceError: it does not answer.
    """

    def __init__(self, host: str, port: int, *, what: str, greeting: bytes = b"") -> None:
        super().__init__(f"{what} at {host}:{port}")
        try:
            self._socket = socket.create_connection((host, port), timeout=CONNECT_WITHIN_S)
            self._socket.sendall(greeting)
            self._socket.settimeout(POLL_S)
        except OSError as error:
            raise DeviceError(f"{self._where} does not answer: {error}") from error

    def _receive(self) -> bytes:
        try:
            data = self._socket.recv(4096)
        except TimeoutError:
            return b""
        except OSError as error:
            raise DeviceError(f"{self._where} is gone: {error}") from error
        if not data:
            raise DeviceError(f"{self._where} closed the connection")
        return data

    def close(self) -> None:
        """As `LineDevice` has it."""
        with suppress(OSError):
            self._socket.close()


class SerialLines(_Port):
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
        super().__init__(f"{what} at {port}")
        self._fault = serial.SerialException
        try:
            self._serial = serial.Serial(port, baud, timeout=POLL_S)
        except (OSError, ValueError) as error:
            raise DeviceError(f"{self._where} cannot be opened: {error}") from error

    def _receive(self) -> bytes:
        try:
            return bytes(self._serial.read(max(1, self._serial.in_waiting)))
        except (OSError, self._fault) as error:
            raise DeviceError(f"{self._where} is gone: {error}") from error

    def close(self) -> None:
        """As `LineDevice` has it."""
        with suppress(OSError):
            self._serial.close()
