"""A node ends with the process that supervises it.

`tuberline run` and `replay` stop their nodes when they leave. Where they are killed they cannot, and a node that went
on would hold the router's port and count into a ledger no one reads. So each looks for its supervisor every second, and
tells it that it is there: one that is stopped or frozen while it starts is missed too.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time

from conveyor.errors import FAULT
from conveyor.notify import notify

ENVIRONMENT = "TUBERLINE_SUPERVISOR"
"""Process id of the supervisor; nodes that systemd or a container engine starts have none."""
LOOK_EVERY_S = 1.0
LEAVE_WITHIN_S = 10.0


def watch_supervisor() -> None:
    """Send SIGTERM to this process when its supervisor, if it has one, is gone."""
    supervisor = os.environ.pop(ENVIRONMENT, "")  # it is not the supervisor of what this process may start
    if supervisor.isdecimal():
        threading.Thread(target=_watch, args=(int(supervisor),), name="supervisor", daemon=True).start()


def _watch(supervisor: int) -> None:
    while os.getppid() == supervisor:
        notify("STATUS=here")
        time.sleep(LOOK_EVERY_S)
    logging.getLogger("supervisor").error("process %d that started this one is gone: stopping", supervisor)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(LEAVE_WITHIN_S)
    os._exit(FAULT)  # one regressor that was still starting did not hear it, and stayed
