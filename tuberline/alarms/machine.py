"""Which alarms begin and which end: what is seen and two clocks in, messages out.

An alarm begins when it was there for `after_s`, ends when it was away for `clear_s`, and begins again no sooner than
`again_after_s` after it began last: one that flaps is one alarm. While there is no contact with the line nothing is
known of what was wrong before, so that nothing ends but what is seen to end. No clock but those given is read.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from conveyor.logs import one_line
from tuberline.alarms.message import MOST_TEXT, AlarmMessage

MOST_BEGINNINGS_PER_MIN = 30
"""Names that come from outside could begin alarms without end. What is held back begins when there is room."""
MINUTE_S = 60.0
MOST_RECENT = 1024


@dataclass(frozen=True, slots=True)
class Seen:
    """One alarm as it is seen now."""

    key: str
    level: str
    text: str
    fix: str
    camera: str = ""


@dataclass(frozen=True, slots=True)
class Active:
    """An alarm whose beginning was told: what was told, and when it was last seen by either clock."""

    begun: AlarmMessage
    begun_s: float
    seen_s: float
    seen_unix_s: float


@dataclass(frozen=True, slots=True)
class Timing:
    """In seconds; see this module."""

    after_s: float = 5.0
    clear_s: float = 10.0
    again_after_s: float = 30.0


@dataclass(slots=True)
class AlarmMachine:
    """The alarms of one line.

    Args:
        prefix: begins every id, so that ids of another outbox differ.
        number: of the next alarm; `active` by key: what was told before a restart and has not ended.
    """

    line: str
    timing: Timing
    prefix: str
    number: int = 0
    active: dict[str, Active] = field(default_factory=dict)
    recent_s: dict[str, float] = field(default_factory=dict)
    """When alarms that have ended began: those that must not begin again yet."""
    _waiting: dict[str, tuple[float, float]] = field(default_factory=dict)
    _beginnings_s: deque[float] = field(default_factory=deque)

    def step(
        self, seen: Iterable[Seen], *, now_s: float, unix_s: float, unknown: frozenset[str] = frozenset()
    ) -> list[AlarmMessage]:
        """What is to be told now.

        Args:
            seen: everything that is wrong.
            now_s: monotonic; unix_s: the wall clock, for what is told.
            unknown: keys of which nothing is known now: they neither begin nor end.
        """
        there = {alarm.key: alarm for alarm in seen}
        self._forget(there, now_s)
        told = self._ends(there, now_s, unix_s, unknown)
        for key, alarm in there.items():
            if key in self.active:
                self.active[key] = replace(self.active[key], seen_s=now_s, seen_unix_s=unix_s)
            elif self._due(key, now_s, unix_s):
                told.append(self._begin(alarm, now_s, unix_s))
        return told

    def _forget(self, there: Mapping[str, Seen], now_s: float) -> None:
        for key in [key for key in self._waiting if key not in there]:
            del self._waiting[key]
        for key in [key for key, begun_s in self.recent_s.items() if now_s - begun_s >= self.timing.again_after_s]:
            del self.recent_s[key]
        while len(self.recent_s) > MOST_RECENT:
            del self.recent_s[next(iter(self.recent_s))]
        while self._beginnings_s and now_s - self._beginnings_s[0] >= MINUTE_S:
            self._beginnings_s.popleft()

    def _ends(
        self, there: Mapping[str, Seen], now_s: float, unix_s: float, unknown: frozenset[str]
    ) -> list[AlarmMessage]:
        told = []
        for key, active in list(self.active.items()):
            if key in there:
                continue
            if key in unknown:
                self.active[key] = replace(active, seen_s=now_s, seen_unix_s=unix_s)
            elif now_s - active.seen_s >= self.timing.clear_s:
                del self.active[key]
                if now_s - active.begun_s < self.timing.again_after_s:
                    self.recent_s[key] = active.begun_s
                ended_unix_s = max(active.seen_unix_s, active.begun.since_unix_s)
                told.append(
                    replace(active.begun, id=f"{active.begun.alarm}-end", event="end", ended_unix_s=ended_unix_s)
                )
        return told

    def _due(self, key: str, now_s: float, unix_s: float) -> bool:
        first_s, _ = self._waiting.setdefault(key, (now_s, unix_s))
        lasts = now_s - first_s >= self.timing.after_s
        return lasts and key not in self.recent_s and len(self._beginnings_s) < MOST_BEGINNINGS_PER_MIN

    def _begin(self, alarm: Seen, now_s: float, unix_s: float) -> AlarmMessage:
        _, since_unix_s = self._waiting.pop(alarm.key)
        name = f"{self.prefix}-{self.number}"
        self.number += 1
        self._beginnings_s.append(now_s)
        text, fix = one_line(alarm.text, most=MOST_TEXT), one_line(alarm.fix, most=MOST_TEXT)
        begun = AlarmMessage(
            id=f"{name}-begin",
            alarm=name,
            event="begin",
            line=self.line,
            camera=alarm.camera,
            key=one_line(alarm.key, most=MOST_TEXT),
            level=alarm.level,
            text=text,
            fix=fix,
            since_unix_s=since_unix_s,
        )
        self.active[alarm.key] = Active(begun, now_s, now_s, unix_s)
        return begun
