"""The one tree of errors a user may see, and the codes a process exits with.

A `TuberlineError` says what is wrong, where, which value was given, what is allowed and how to mend it.
The command line prints its text alone and exits with `exit_code`; anything else is a bug and keeps its
traceback.

An error is permanent or passing. A permanent one (input, configuration, version, a name that is taken) would come again
at every start: supervisor and systemd leave the process alone. A passing one (link, disk, device) may be gone in a
minute: they start the process again, with back-off, for ever.
"""

PERMANENT = 2
"""Exit code of an error that no restart mends."""
FAULT = 70
"""Exit code of a fault of the program: an exception that nobody expected (EX_SOFTWARE of sysexits.h)."""
PASSING = 75
"""Exit code of an error that may be gone at the next start (EX_TEMPFAIL of sysexits.h)."""


class TuberlineError(Exception):
    """Base of every error that is the input's, the configuration's or the machine's, not the program's."""

    exit_code = PERMANENT


class InputError(TuberlineError):
    """A file, recording or cloud that cannot be used as it is."""


class ConfigError(TuberlineError):
    """A configuration that is refused."""


class TakenError(TuberlineError):
    """Somebody else lives under this name or listens on this port; the text says who."""


class MessageError(TuberlineError):
    """Bytes from the wire that are not a message of ours, or not of our version."""


class LedgerError(TuberlineError):
    """The ledger cannot be trusted."""


class StorageError(LedgerError):
    """The disk is full, read-only, away or reports errors: what is stored is as it was."""

    exit_code = PASSING


class DeviceError(InputError):
    """A camera or its driver is not there, or does not answer."""

    exit_code = PASSING


class LinkError(TuberlineError):
    """The router or a peer process cannot be reached."""

    exit_code = PASSING
