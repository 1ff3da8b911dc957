"""The one tree of errors a user may see.

A `TuberlineError` says what is wrong, where, which value was given, what is allowed and how to mend it.
The command line prints its text alone and exits with `exit_code`; anything else is a bug and keeps its
traceback.
"""

from __future__ import annotations

from enum import StrEnum


class TuberlineError(Exception):
    """Base of every error that is the input's, the configuration's or the machine's, not the program's."""

    exit_code = 2


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


class MessageError(TuberlineError):
    """Bytes from the wire that are not a message of ours, or not of our version."""

    def __init__(self, text: str, *, reason: Refusal = Refusal.CONTENT) -> None:
        super().__init__(text)
        self.reason = reason


class UnsendableError(MessageError):
    """A message of this process' own that its class does not allow; nothing was sent. A fault of the program."""

    exit_code = 70


class LedgerError(TuberlineError):
    """The ledger cannot be trusted or cannot be written."""


class LinkError(TuberlineError):
    """The router or a peer process cannot be reached."""
