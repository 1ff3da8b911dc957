"""What Linux tells of a process under /proc."""

from __future__ import annotations

import os
from pathlib import Path

TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def stat_fields(pid: int | None) -> list[str]:
    """Fields of /proc/PID/stat behind the process's name, which may hold anything: its state, then its parent.

    Raises:
        OSError: it is gone.
    """
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()


def cpu_s(pid: int | None) -> float:
    """CPU seconds a process has used; 0 where it is gone."""
    try:
        fields = stat_fields(pid)
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def parent_of(pid: int | None) -> int | None:
    """The process that one was forked from, or started by; None where it is gone."""
    try:
        return int(stat_fields(pid)[1])
    except OSError:
        return None
