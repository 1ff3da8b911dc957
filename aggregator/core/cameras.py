"""Who is expected, how far each camera has seen, and who is no longer waited for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from aggregator.core.travel import TravelCurve, common_travel_m, head_start_m
from conveyor.messages import Mark, TrackEntry

STARTUP_GRACE_S = 60.0
"""A camera never heard of is waited for at least this long: processes of one line do not start at once."""

LINE_SLACK_M = 0.02
"""Places are known to a few millimetres: this far from the watermark nothing is committed yet."""


@dataclass(slots=True)
class CameraState:
    """What one camera last said, and when it was last heard (seconds of the aggregator's clock)."""

    started_s: float
    heard_s: float | None = None
    gone_s: float | None = None
    marks: list[Mark] = field(default_factory=list)
    """Marks not yet used for the watermark, oldest first; the newest is always kept."""
    mark: Mark | None = None
    curve: TravelCurve = field(default_factory=TravelCurve)

    @property
    def final(self) -> bool:
        """Its last mark said that nothing follows."""
        return self.mark is not None and self.mark.final

    def stalled(self, now_s: float, *, stall_s: float) -> bool:
        """Silent for longer than `stall_s`, or its process gone for half of that (time for a restart)."""
        if self.final:
            return False
        if self.heard_s is None:
            return now_s - self.started_s >= max(stall_s, STARTUP_GRACE_S)
        gone = self.gone_s is not None and now_s - max(self.gone_s, self.heard_s) >= stall_s / 2
        return gone or now_s - self.heard_s >= stall_s

    def says(self, now_s: float, *, stall_s: float) -> str:
        """One word for a person."""
        if self.final:
            return "ended"
        if self.stalled(now_s, stall_s=stall_s):
            return "silent"
        return "waiting" if self.heard_s is None else "running"


class Cameras:
    """All cameras of a line; the first by name is the reference of travel where there is no encoder."""

    def __init__(self, names: tuple[str, ...], *, stall_s: float, now_s: float) -> None:
        self.names = tuple(sorted(names))
        self.states = {name: CameraState(now_s) for name in self.names}
        self._stall_s = stall_s
        self._head_start_m: float | None = None

    @property
    def final(self) -> bool:
        """Every camera ended."""
        return bool(self.names) and all(state.final for state in self.states.values())

    def heard(self, camera: str, entry: TrackEntry, now_s: float) -> None:
        """An entry came from `camera`. A mark that repeats an old moment shows no progress and does not count."""
        state = self.states[camera]
        newest = state.mark.captured_ns if state.mark else None
        if entry.mark is None or entry.mark.final or newest is None or entry.mark.captured_ns > newest:
            state.heard_s = now_s

    def presence(self, camera: str, *, alive: bool, now_s: float) -> None:
        """The liveliness token of the camera's segmenter is there or gone."""
        state = self.states[camera]
        state.gone_s = None if alive else (now_s if state.gone_s is None else state.gone_s)

    def marked(self, camera: str, mark: Mark) -> None:
        """A mark was applied."""
        state = self.states[camera]
        state.marks.append(mark)
        state.mark = mark
        if mark.travel_estimated:
            state.curve.add(mark.captured_ns, mark.travel_m)

    def place_x_m(
        self, camera: str, own_place_x_m: float, *, t_ns: int, own_travel_m: float, estimated: bool
    ) -> float | None:
        """A place of `camera`'s in terms of the line's travel, metres; None while that is not known."""
        if not estimated:
            return own_place_x_m
        curves = {name: state.curve for name, state in self.states.items()}
        if self._head_start_m is None:
            self._head_start_m = head_start_m(curves, reference=self.names[0])
        if self._head_start_m is None:
            return None
        travel_m = common_travel_m(curves, reference=self.names[0], camera=camera, t_ns=t_ns, own_travel_m=own_travel_m)
        return None if travel_m is None else own_place_x_m + own_travel_m - travel_m - self._head_start_m

    def says(self, now_s: float) -> Mapping[str, str]:
        """One word for each camera."""
        return {name: state.says(now_s, stall_s=self._stall_s) for name, state in self.states.items()}

    def watermark_x_m(self, now_s: float, *, wait: bool = True) -> float:
        """Nothing more can come at this place or further along: infinite while some camera has said nothing yet.

        Cameras that ended or stalled hold nobody up; where all stalled, or with `wait` false, the one that got
        farthest decides alone.
        """
        stalled = {name for name, state in self.states.items() if state.stalled(now_s, stall_s=self._stall_s)}
        for name, state in self.states.items():
            state.curve.closed = state.final or name in stalled
        complete = {name: self._complete_x_m(name) for name in self.names}
        expected = [complete[name] for name in self.names if name not in stalled]
        if not complete:
            return math.inf
        return max(expected) if expected and wait else min(complete.values())

    def _complete_x_m(self, camera: str) -> float:
        """Where `camera` is complete, by its newest mark whose moment the line's travel reaches."""
        state = self.states[camera]
        if state.final:
            return -math.inf
        for at in range(len(state.marks) - 1, -1, -1):
            mark = state.marks[at]
            place = self.place_x_m(
                camera,
                mark.complete_place_x_m,
                t_ns=mark.captured_ns,
                own_travel_m=mark.travel_m,
                estimated=mark.travel_estimated,
            )
            if place is not None:
                del state.marks[:at]
                return place
        return math.inf
