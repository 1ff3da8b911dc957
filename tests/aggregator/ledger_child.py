"""Run by test_aggregator_kill.py: for each job a forked process that commits a story and is killed on the way.

A job is a JSON list: folder, seed of the story, number of the write point at which to die, or a time in seconds. What
was acknowledged is appended to `<folder>/acknowledged`, one 'camera n' a line, by a single write each.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

from aggregator.ledger.writer import Ledger
from tests.aggregator.belt_story import tell
from tests.aggregator.virtual_line import Aggregator


class Countdown:
    """Dies at the given write point, like a process that is killed there."""

    def __init__(self, left: int) -> None:
        self.left = left

    def __call__(self, name: str) -> None:
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        self.left -= 1


def commit_story(folder: Path, seed: int, steps: int) -> None:
    """Commit a story entry by entry, saying what is acknowledged, until killed or done."""
    told = tell(seed, n=10, cameras=2)
    log = os.open(folder / "acknowledged", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    with Ledger(folder / "ledger.db", step=Countdown(steps)) as ledger:
        it = Aggregator(ledger, told)
        for _ in it.commits():
            os.write(log, "".join(f"{camera} {n}\n" for camera, n in it.acknowledged.items()).encode())


def main() -> None:
    """One forked child a job; this process holds no thread and no open file that matters."""
    for folder, seed, steps, after_s in json.loads(sys.stdin.read()):
        child = os.fork()
        if child == 0:
            commit_story(Path(folder), seed, steps)
            os._exit(0)
        if after_s:
            time.sleep(after_s)
            os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        sys.stdout.write(f"{status}\n")


if __name__ == "__main__":
    main()
