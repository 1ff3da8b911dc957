"""The one tree of errors a user may see, and the codes a process exits with.

A `TuberlineError` says what is wrong, where, which value was given, what is allowed and how to fix it.
The command line prints its text alone and exits with `exit_code`; anything else is a bug and keeps its
traceback.

An error is permanent or passing. A permanent one (input, configuration, version, a name that is taken) would come again
at every start: supervisor and systemd leave the process alone. A passing one (link, disk, device) may be gone in a
minute: they start the process again, with back-off, forever.
"""

from __future__ import annotations

from enum import StrEnum

PERMANENT = 2
"""Exit code of an error that no restart cures."""
FAULT = 70
"""Exit code of a fault of the program: an exception that no one expected (EX_SOFTWARE of sysexits.h)."""
PASSING = 75
"""Exit code of an error that may be gone at the next start (EX_TEMPFAIL of sysexits.h)."""


class TuberlineError(Exception):
    """Base of every error that is the input's, the configuration's or the machine's, not the program's."""

    exit_code = PERMANENT


class InputError(TuberlineError):
    """A file, recording or cloud that cannot be used as it is."""


class ConfigError(TuberlineError):
    """A configuration that is refused."""


class Refusal(StrEnum):
    """Why a message was refused, in a word: what refusals are counted by."""

    FOREIGN = "foreign"
    """Not ours: too short, or another magic."""
    VERSION = "version"
    """Ours, of another release."""
    SIZE = "size"
    """Larger than allowed: the message, its header, an array, or the number of something."""
    HEADER = "header"
    """A header that cannot be read, or lacks something."""
    KIND = "kind"
    """A message, of another kind than belongs here."""
    FIELD = "field"
    """A field that is missing, unknown, or of another type."""
    RANGE = "range"
    """A value outside what its field may hold."""
    ARRAY = "array"
    """An array that is missing, unknown, truncated, or of another dtype or shape."""
    CONTENT = "content"
    """Fields that contradict each other."""


class TakenError(TuberlineError):
    """Somebody else lives under this name or listens on this port; the text says who."""


class MessageError(TuberlineError):
    """Bytes from the wire that are not a message of ours, or not of our version."""

    def __init__(self, text: str, *, reason: Refusal = Refusal.CONTENT) -> None:
        super().__init__(text)
        self.reason = reason


class UnsendableError(MessageError):
    """A message of this process' own that its class does not allow; nothing was sent. A fault of the program."""

    exit_code = 70


class LedgerError(TuberlineError):
    """The ledger cannot be trusted."""


class NoLedgerError(LedgerError):
    """A file that is no ledger, nor the damaged rest of one."""


class UnmadeError(LedgerError):
    """A file that no aggregator has made a ledger of yet, or the empty part of one."""


class StorageError(LedgerError):
    """The disk is full, read-only, away or reports errors: what is stored is as it was."""

    exit_code = PASSING


class OutputError(InputError):
    """A file cannot be written now: its disk is full, read-only, away or reports errors."""

    exit_code = PASSING


class DeviceError(InputError):
    """A camera or its driver is not there, or does not answer."""

    exit_code = PASSING


class LinkError(TuberlineError):
    """The router, a peer process or another server cannot be reached."""

    exit_code = PASSING
