"""Health of the line's nodes: a lane per node, and a log line for whatever was dropped."""

from __future__ import annotations

from collections.abc import Iterable

from conveyor.messages import Counters
from viewer.scene.primitives import Entry, Lane, Level, LogLine, Moment, State

BAD = ("dropped", "refused", "missed", "lost", "gap", "stall", "discarded", "requeue", "restart", "failed")
"""A counter whose name holds one of these counts something that a person may have to look into."""
MAX_NODES = 256


class HealthScene:
    """What was said last about each node."""

    def __init__(self) -> None:
        self._bad: dict[str, dict[str, int]] = {}
        self._pid: dict[str, int] = {}
        self._state: dict[str, str] = {}

    def update(self, counters: Iterable[Counters], alive: set[str], moment: Moment) -> list[Entry]:
        """Draw what changed since the last call. `alive` holds 'role/name' of every token."""
        entries: list[Entry] = []
        known = {f"{c.role}/{c.name}": c for c in counters}
        for node in sorted(known.keys() | alive)[:MAX_NODES]:
            report = known.get(node)
            if report is not None:
                entries += self._drops(node, report, moment)
            state = "gone" if node not in alive else "starting" if report is None else report.status
            if node not in self._state:
                entries.append(Entry(f"/health/{node}", Lane(), None))
            if state != self._state.get(node):
                self._state[node] = state
                level: Level = "ERROR" if state == "gone" else "INFO" if state in ("ok", "starting") else "WARN"
                entries.append(Entry(f"/health/{node}", State(state), moment))
                entries.append(Entry(f"/log/{node}", LogLine(f"{node} is {state}", level), moment))
        return entries

    def _drops(self, node: str, report: Counters, moment: Moment) -> list[Entry]:
        if self._pid.get(node) != report.pid:  # a restarted process counts from zero
            self._pid[node] = report.pid
            self._bad[node] = {}
        before = self._bad[node]
        now = {name: n for name, n in report.values.items() if n and any(word in name for word in BAD)}
        grown = [f"{name} +{n - before.get(name, 0)} (now {n})" for name, n in now.items() if n > before.get(name, 0)]
        self._bad[node] = now
        return [Entry(f"/log/{node}", LogLine(f"{node}: {', '.join(grown)}", "WARN"), moment)] if grown else []
