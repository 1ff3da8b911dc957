"""A share of one core for a process: the kernel's CPU bandwidth control, cgroup v2 or v1."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path
from typing import Self

from conveyor.errors import TuberlineError

PERIOD_US = 50_000
CGROUP_V2 = Path("/sys/fs/cgroup")
CGROUP_V1 = Path("/sys/fs/cgroup/cpu")


class CpuShare:
    """A cgroup that gives all processes in it together `share` of one core, in a `with` block.

    Raises:
        TuberlineError: neither version of cgroups can be written here.
    """

    def __init__(self, name: str, *, share: float) -> None:
        self._folder = _root() / name
        self._quota_us = round(share * PERIOD_US)

    def __enter__(self) -> Self:
        try:
            self._folder.mkdir()
        except OSError as error:
            raise TuberlineError(f"no cgroup can be made at {self._folder}: {error.strerror}") from error
        if _is_v2():
            (self._folder / "cpu.max").write_text(f"{self._quota_us} {PERIOD_US}")
        else:
            (self._folder / "cpu.cfs_period_us").write_text(str(PERIOD_US))
            (self._folder / "cpu.cfs_quota_us").write_text(str(self._quota_us))
        return self

    def __exit__(self, *_: object) -> None:
        deadline = time.monotonic() + 2.0
        while self._folder.exists() and time.monotonic() < deadline:
            with suppress(OSError):  # busy until the kernel has buried the last process
                self._folder.rmdir()
            time.sleep(0.02)

    def add(self, pid: int) -> None:
        """Limit this process from now on, all its threads."""
        (self._folder / "cgroup.procs").write_text(str(pid))


def _is_v2() -> bool:
    return (CGROUP_V2 / "cgroup.controllers").exists()


def _root() -> Path:
    """Where groups with CPU bandwidth control are made."""
    if not _is_v2():
        if not (CGROUP_V1 / "cpu.cfs_quota_us").parent.is_dir() or not os.access(CGROUP_V1, os.W_OK):
            raise TuberlineError(f"equal shares of CPU need cgroups: neither v2 nor a writable v1 at {CGROUP_V1}")
        return CGROUP_V1
    control = CGROUP_V2 / "cgroup.subtree_control"
    with suppress(OSError):
        control.write_text("+cpu")
    if "cpu" not in control.read_text().split():
        raise TuberlineError(f"equal shares of CPU need the cpu controller in {control}; it cannot be enabled here")
    return CGROUP_V2
