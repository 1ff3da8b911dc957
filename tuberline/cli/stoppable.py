"""Ctrl-C ends long work within a second, whatever it is doing, and leaves no output in halves."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

from conveyor.logs import flush_outputs
from tuberline.cli.leaving import told_to_end

STOPPED = 130
"""Exit code after Ctrl-C, as shells give it: 128 + SIGINT."""
WITHIN_S = 0.7
"""Compiled code (a network's layers, a compiler's run) sees no interrupt; after this the process ends without it."""


class Request:
    """A first Ctrl-C that is left to the work, which stops where it loses nothing; a second one stops it at any point.

    Attributes:
        heeds: set while the work looks at `made` now and then.
        made: set by such a Ctrl-C.
    """

    def __init__(self) -> None:
        self.heeds = threading.Event()
        self.made = threading.Event()


@contextmanager
def stoppable(
    how_far: Callable[[], str], request: Request | None = None, *, on_request: Callable[[], None] = lambda: None
) -> Iterator[threading.Event]:
    """Work that Ctrl-C may stop at any point; once it ended or was stopped Ctrl-C does nothing: output is whole.

    Args:
        request: for work that can be asked to stop. on_request: called when it is, on another thread.

    Yields:
        set when the work was stopped; what `how_far` says was written to stderr then.
    """
    stopped = threading.Event()
    ended = threading.Event()
    read, write = os.pipe()
    os.set_blocking(write, False)
    asked = request or Request()
    guard = threading.Thread(
        target=_leave_at_last, args=(read, ended, how_far, asked, on_request), name="stop", daemon=True
    )
    former = signal.signal(signal.SIGINT, lambda *_: _interrupt(asked))
    former_fd = signal.set_wakeup_fd(write, warn_on_full_buffer=False)  # told by the C handler, whatever is busy
    guard.start()
    try:
        yield stopped
    except KeyboardInterrupt:
        stopped.set()
    except (SystemError, RuntimeError) as error:
        if told_to_end(error) is None:
            raise
        stopped.set()
    finally:
        signal.signal(signal.SIGINT, _heard_already if stopped.is_set() else former)
        signal.set_wakeup_fd(former_fd)
        ended.set()
        os.close(write)
    if stopped.is_set():
        sys.stderr.write(f"tuberline: {how_far()}\n")
    else:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def leave() -> NoReturn:
    """End the process after a stop. A library whose import was broken off may crash in the interpreter's goodbye."""
    flush_outputs()
    os._exit(STOPPED)


def _interrupt(request: Request) -> None:
    if request.heeds.is_set() and not request.made.is_set():
        request.made.set()  # no one else sets it or waits for it: its lock is free
        return
    signal.signal(signal.SIGINT, _heard_already)  # a second Ctrl-C must not break into what the first one began
    raise KeyboardInterrupt


def _heard_already(_number: int, _frame: object) -> None:
    """Of one that came before this was set Python would write an error if it were then to be ignored (`SIG_IGN`)."""


def _leave_at_last(
    read: int, ended: threading.Event, how_far: Callable[[], str], request: Request, on_request: Callable[[], None]
) -> None:
    """Wait for the interrupt that is not left to the work; end the process if that has not ended by itself soon after.

    Python tells of one where there were two while compiled code was busy: they are counted here.
    """
    heard = 0
    while signals := os.read(read, 64):
        new = signals.count(signal.SIGINT)
        heard += new
        if new and heard == 1 and request.heeds.is_set():
            on_request()
        elif new:
            break
    else:  # the work is over
        os.close(read)
        return
    if not ended.wait(WITHIN_S):
        os.write(2, f"tuberline: {how_far()}\n".encode())
        os._exit(STOPPED)
