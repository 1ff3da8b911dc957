"""`tuberline`: one command per job. Commands live in modules of their own and are imported when they run: help stays
quick. This package is the composition root, the only place that knows the other packages.
"""

from __future__ import annotations

import signal
import threading

__all__ = ["main"]


def main() -> None:
    """Entry point. Ctrl-C while modules are loaded, a third of a second or more, ends the process as the system does:
    nothing has begun that has to be tidied up, and there is no one yet to take it for anything but a bug.
    """
    ours = threading.current_thread() is threading.main_thread()
    if loading := ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from tuberline.cli.entry import enter

    if loading:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    enter()
