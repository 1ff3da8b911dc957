"""How busy a machine's processors are."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from conveyor.processors import EVERY_S, Processors

pytestmark = pytest.mark.skipif(not Path("/proc/stat").exists(), reason="the kernel's count is Linux's")


def test_the_share_of_this_machine_is_one_of_its_own_processors() -> None:
    processors, begun = Processors(), time.monotonic()
    assert processors.busy(begun) is None
    while time.monotonic() < begun + EVERY_S + 0.1:  # work, not sleep: one processor is used in full
        pass
    found = processors.busy(time.monotonic())
    assert found is not None
    assert found.processors == len(os.sched_getaffinity(0))
    assert 0.5 / found.processors <= found.share <= 1.0


def test_a_process_that_may_use_one_processor_knows() -> None:
    said = "import os; from conveyor.processors import usable; "
    said += "os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}); assert usable() == 1, usable()"
    subprocess.run([sys.executable, "-c", said], check=True, timeout=60)


def test_waiting_for_a_disk_is_not_work_and_guests_count_once(tmp_path: Path) -> None:
    stat, mine = tmp_path / "stat", min(os.sched_getaffinity(0))

    def say(user: int, idle: int, disk: int, guest: int) -> None:
        stat.write_text(f"cpu  1 1 1 1 1 1 1 1 1 1\ncpu{mine} {user} 0 0 {idle} {disk} 0 0 0 {guest} 0\nintr 5\n")

    say(100, 100, 100, 50)
    processors = Processors(stat)
    assert processors.busy(1.0) is None
    say(130, 150, 120, 80)
    assert processors.busy(1.0 + EVERY_S / 2) is None, "too soon"
    found = processors.busy(1.0 + EVERY_S)
    assert found is not None
    assert (found.share, found.processors) == (pytest.approx(0.3), 1)


def test_a_system_without_such_a_count_is_not_known(tmp_path: Path) -> None:
    processors = Processors(tmp_path / "none")
    assert [processors.busy(float(at)) for at in range(4)] == [None] * 4
