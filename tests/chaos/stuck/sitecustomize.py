"""On PYTHONPATH of a real process: SIGUSR1 makes it hold the interpreter lock for 3 s, SIGUSR2 forever.
SIGALRM makes its main thread sleep, while all others go on.

It is what a native call does that never lets go: no Python thread runs, and Zenoh keeps the liveliness token.
"""

from __future__ import annotations

import ctypes
import signal
import time
from types import FrameType

SECONDS = {signal.SIGUSR1: 3, signal.SIGUSR2: 100_000}


def hold(number: int, _frame: FrameType | None) -> None:
    """Sleep in C without letting go of the lock, as `ctypes.CDLL` would."""
    ctypes.PyDLL(None).sleep(SECONDS[signal.Signals(number)])


def sleep(_number: int, _frame: FrameType | None) -> None:
    """The main loop is stuck, as in a call that waits forever; the node still reports."""
    time.sleep(100_000)


signal.signal(signal.SIGALRM, sleep)
for _number in SECONDS:
    signal.signal(_number, hold)
