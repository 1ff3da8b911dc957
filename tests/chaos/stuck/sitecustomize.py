"""On PYTHONPATH of a real process: SIGUSR1 makes it hold the interpreter lock for 3 s, SIGUSR2 for ever.

It is what a native call does that never lets go: no Python thread runs, and Zenoh keeps the liveliness token.
"""

from __future__ import annotations

import ctypes
import signal
from types import FrameType

SECONDS = {signal.SIGUSR1: 3, signal.SIGUSR2: 100_000}


def hold(number: int, _frame: FrameType | None) -> None:
    """Sleep in C without letting go of the lock, as `ctypes.CDLL` would."""
    ctypes.PyDLL(None).sleep(SECONDS[signal.Signals(number)])


for _number in SECONDS:
    signal.signal(_number, hold)
