"""A command that is told to end leaves by an exception, so that it stops the processes it started and tidies up."""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType

AGAIN_AFTER_S = 0.05
_told: list[int] = []
"""Signals that this command was told to end by. A list: a handler may take no lock."""


class Told(SystemExit):
    """The command was told to end by SIGTERM, or by its terminal, which was closed."""


def leave_when_told() -> None:
    """SIGTERM ends this command by `Told`, wherever it is; nodes have handlers of their own. A terminal that is closed
    (SIGHUP) is SIGTERM to them all, but where they are to outlive it (nohup).

    Python drops what is raised while it calls back for an object that is gone, and goes on: such a signal, SIGINT
    too, is given again.
    """
    signal.signal(signal.SIGTERM, _leave)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        signal.signal(signal.SIGHUP, lambda *_: signal.raise_signal(signal.SIGTERM))
    sys.unraisablehook = _dropped


def told_to_end(error: BaseException | None) -> int | None:
    """The exit code where behind an error stands that the command was told to end; None where it does not.

    Compiled code that is interrupted, numba's for one, makes an error of it, and Python 3.11 while it makes a class.
    """
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return 128 + signal.SIGINT
        if isinstance(error, Told):
            return int(error.code or 0)
        error = error.__cause__ or error.__context__
    return None


def swallowed(error: BaseException) -> int | None:
    """The exit code where the command was told to end and something took that for an error of its own, as pydantic
    does for a value that does not match: `error` knows nothing of it then. One that came while it left does.
    """
    return 128 + _told[0] if _told and told_to_end(error) is None else None


def _leave(number: int, _frame: FrameType | None) -> None:
    _told.append(number)
    raise Told(128 + number)


def _dropped(dropped: sys.UnraisableHookArgs) -> None:
    numbers = {Told: signal.SIGTERM, KeyboardInterrupt: signal.SIGINT}
    if (number := numbers.get(dropped.exc_type)) is None:
        if not _told:  # else of what was interrupted while it was made
            sys.__unraisablehook__(dropped)
        return
    again = threading.Timer(AGAIN_AFTER_S, os.kill, (os.getpid(), number))
    again.daemon = True
    again.start()
