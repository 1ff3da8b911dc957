"""The one tree of errors a user may see.

A `TuberlineError` says what is wrong, where, which value was given, what is allowed and how to mend it.
The command line prints its text alone and exits with `exit_code`; anything else is a bug and keeps its
traceback.
"""


class TuberlineError(Exception):
    """Base of every error that is the input's, the configuration's or the machine's, not the program's."""

    exit_code = 2


class InputError(TuberlineError):
    """A file, recording or cloud that cannot be used as it is."""


class ConfigError(TuberlineError):
    """A configuration that is refused."""


class MessageError(TuberlineError):
    """Bytes from the wire that are not a message of ours, or not of our version."""


class LedgerError(TuberlineError):
    """The ledger cannot be trusted or cannot be written."""


class LinkError(TuberlineError):
    """The router or a peer process cannot be reached."""
