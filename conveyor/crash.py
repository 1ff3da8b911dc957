"""An exception that no one expected ends the process, in whichever thread it comes.

Python lets a thread die and Zenoh logs what its callbacks raise; the process then lives on without a part of itself,
and its liveliness token too. Ended with a code of its own it is started again.
"""

from __future__ import annotations

import logging
import os
import threading
import traceback

from conveyor.errors import FAULT
from conveyor.logs import flush_outputs, say

leaving = threading.Event()
"""Set once the process stops: what its threads meet while their session is closed under them is no fault."""


def end_on_faults() -> None:
    """From here on an uncaught exception in any thread, Zenoh's callbacks included, ends this process with `FAULT`."""
    threading.excepthook = _thread_fault
    logging.getLogger("zenoh.handlers").addHandler(_CallbackFault())


def _thread_fault(fault: threading.ExceptHookArgs) -> None:
    if fault.exc_type is SystemExit or leaving.is_set():
        return
    name = fault.thread.name if fault.thread is not None else "?"
    say("".join(traceback.format_exception(fault.exc_type, fault.exc_value, fault.exc_traceback)))
    _end(f"thread '{name}' failed: {fault.exc_value!r}")


class _CallbackFault(logging.Handler):
    """Zenoh for Python logs a callback's exception here, and goes on."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info is None or leaving.is_set():
            return
        say("".join(traceback.format_exception(record.exc_info[1])))
        _end(f"a Zenoh callback failed: {record.exc_info[1]!r}")


def _end(why: str) -> None:
    logging.getLogger("crash").error("%s: ending with code %d", why, FAULT)
    flush_outputs()
    os._exit(FAULT)
