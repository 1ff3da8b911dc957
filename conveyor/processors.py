"""How busy this machine's processors are: all that run on it, not this process alone."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

STAT = Path("/proc/stat")
EVERY_S = 0.5
"""A shorter time is a matter of chance: the kernel counts in hundredths of a second."""
IDLE_FIELDS = (3, 4)
"""Of a line of /proc/stat, behind its name: idle, and waiting for a disk."""
OWN_FIELDS = 8
"""The fields behind them are guests' time, which is counted among the first already."""


@dataclass(frozen=True, slots=True)
class Busy:
    """`share`, 0..1, of the time of `processors` that was used."""

    share: float
    processors: int


def usable() -> int:
    """Processors that this process may run on."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # another system than Linux
        return os.cpu_count() or 1


class Processors:
    """Measures the processors that this process may run on, from call to call. Elsewhere than on Linux: nothing."""

    def __init__(self, stat: Path = STAT) -> None:
        self._stat = stat
        self._before = _ticks(stat)
        self._measured_s: float | None = None
        self._found: Busy | None = None

    def busy(self, now_s: float) -> Busy | None:
        """Since the last measurement, which is at least `EVERY_S` old; None where it is not known (yet)."""
        if self._measured_s is None:
            self._measured_s = now_s
        if now_s - self._measured_s < EVERY_S:
            return self._found
        self._measured_s = now_s
        before, self._before = self._before, _ticks(self._stat)
        both = before.keys() & self._before.keys()
        total = sum(self._before[name][1] - before[name][1] for name in both)
        if total > 0:
            used = sum(self._before[name][0] - before[name][0] for name in both)
            self._found = Busy(min(1.0, max(0.0, used / total)), len(both))
        return self._found


def _ticks(stat: Path) -> dict[str, tuple[int, int]]:
    """(used, all) ticks of each processor that this process may run on, by its name there."""
    try:
        lines = stat.read_text(encoding="ascii").splitlines()
        mine = {f"cpu{number}" for number in os.sched_getaffinity(0)}
    except (OSError, AttributeError):  # another system than Linux
        return {}
    out = {}
    for name, *fields in (line.split() for line in lines if line.startswith("cpu")):
        if name in mine:
            ticks = [int(field) for field in fields[:OWN_FIELDS]]
            out[name] = (sum(ticks) - sum(ticks[at] for at in IDLE_FIELDS), sum(ticks))
    return out
