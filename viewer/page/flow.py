"""What comes along now: tubers and kilograms a minute from the totals, belt speed from the travel told by the nodes."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from conveyor.messages import Totals, Travel
from viewer.page.state import Flow, Rate

QUIET_S = 15.0
"""No tuber for so long: nothing comes. The totals' own rate stays what it was at the last tuber."""
WEIGHT_WINDOW_S = 60.0
LEAST_TUBERS = 5
SPEED_WINDOW_NS = 2_000_000_000
TRAVEL_STALE_S = 3.0
MAX_SOURCES = 32
STEP_S, STEPS = 10.0, 60


@dataclass(slots=True)
class LoadFlow:
    """Tubers and kilograms a minute, in the belt's own time: also right where a recording runs faster than life."""

    _points: deque[tuple[float, int, float]] = field(default_factory=deque)
    _run: str = ""
    _moved_s: float = 0.0
    _per_s: float = 0.0

    def add(self, totals: Totals, now_s: float) -> None:
        """Take new totals."""
        last = self._points[-1] if self._points else None
        if totals.run != self._run or (last is not None and totals.count < last[1]):
            self._points.clear()
            self._run, last = totals.run, None
        if last is None or totals.count > last[1]:
            self._moved_s = now_s
        self._per_s = totals.tubers_per_s
        self._points.append((now_s, totals.count, totals.weight_g))
        while len(self._points) > 2 and self._points[0][0] < now_s - WEIGHT_WINDOW_S:
            self._points.popleft()

    def per_min(self, now_s: float) -> tuple[float, float] | None:
        """(tubers, kilograms) a minute; None before there are totals."""
        if not self._points:
            return None
        (_, first_count, first_g), (_, count, weight_g) = self._points[0], self._points[-1]
        if now_s - self._moved_s > QUIET_S or count == 0:
            return 0.0, 0.0
        new = count - first_count
        mean_g = (weight_g - first_g) / new if new >= LEAST_TUBERS else weight_g / count
        tubers = 60.0 * self._per_s
        return tubers, tubers * mean_g / 1000.0


@dataclass(slots=True)
class BeltSpeed:
    """Metres a second of the belt, by the clock of who saw it move. An encoder is believed before an estimate."""

    _points: dict[str, deque[Travel]] = field(default_factory=dict)
    _heard_s: dict[str, float] = field(default_factory=dict)

    def add(self, travel: Travel, now_s: float) -> None:
        """Take where the belt is by one source."""
        if travel.source not in self._points and len(self._points) >= MAX_SOURCES:
            return
        points = self._points.setdefault(travel.source, deque())
        if points and (travel.run != points[-1].run or travel.captured_ns <= points[-1].captured_ns):
            points.clear()
        points.append(travel)
        while len(points) > 2 and points[1].captured_ns < travel.captured_ns - SPEED_WINDOW_NS:
            points.popleft()
        self._heard_s[travel.source] = now_s

    def since_s(self, now_s: float) -> dict[str, float]:
        """Since each source last told, seconds."""
        return {source: now_s - heard_s for source, heard_s in self._heard_s.items()}

    def m_per_s(self, now_s: float) -> float | None:
        """The belt's speed; None where no one has told of it for some seconds."""
        told = [
            (points[-1].estimated, (points[-1].travel_m - points[0].travel_m) / seconds)
            for source, points in sorted(self._points.items())
            if now_s - self._heard_s[source] <= TRAVEL_STALE_S
            and (seconds := (points[-1].captured_ns - points[0].captured_ns) / 1e9) > 0
        ]
        if not told:
            return None
        best = [speed for estimated, speed in told if not estimated] or [speed for _, speed in told]
        return sum(best) / len(best)


@dataclass(slots=True)
class RateHistory:
    """The flow of the last `STEPS` steps of `STEP_S` seconds, each the mean of what was told in it."""

    _steps: dict[int, tuple[float, float, int]] = field(default_factory=dict)

    def add(self, now: Flow, now_s: float) -> None:
        """Take the flow of this moment."""
        if now.tubers_per_min is None or now.kg_per_min is None:
            return
        step = int(now_s // STEP_S)
        tubers, kilograms, n = self._steps.get(step, (0.0, 0.0, 0))
        self._steps[step] = (tubers + now.tubers_per_min, kilograms + now.kg_per_min, n + 1)
        for old in [each for each in self._steps if each <= step - STEPS]:
            del self._steps[old]

    def rate(self, now_s: float) -> Rate:
        """All steps up to this moment."""
        newest = int(now_s // STEP_S)
        found = [self._steps.get(step) for step in range(newest - STEPS + 1, newest + 1)]
        return Rate(
            STEP_S,
            tuple(None if step is None else round(step[0] / step[2], 1) for step in found),
            tuple(None if step is None else round(step[1] / step[2], 2) for step in found),
        )


def flow(load: LoadFlow, belt: BeltSpeed, now_s: float) -> Flow:
    """Everything that comes along at this moment."""
    per_min = load.per_min(now_s)
    tubers, kilograms = per_min if per_min is not None else (None, None)
    return Flow(tubers, kilograms, belt.m_per_s(now_s))
