"""Who is expected, how far each camera has seen, and who is no longer waited for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from aggregator.core.camera_clocks import CameraClocks
from aggregator.core.coverage import Moment
from aggregator.core.reasons import CameraWord
from aggregator.core.sight import CameraSight
from aggregator.core.travel import LineTravel, TravelCurve, TravelKnown
from conveyor.camera_clock import STANDS_AFTER_S
from conveyor.messages import CameraInfo, Mark, TrackEntry, Travel
from conveyor.messages.tracks import CARRIED

STARTUP_GRACE_S = 60.0
"""A camera never heard of is waited for at least this long: processes of one line do not start at once."""

LEAD_WITHIN_S = 30.0
"""What a camera says of itself for so long tells how long before its first frame the load began."""

INFO_AGE_S = 1.5
"""A camera that publishes says so twice a second: then it, and not our clock, says until when its belt ran. Three words
missed are a router or a camera that stands still; 3 s told 0.2 m too little of a line that was stopped meanwhile."""

CLOCKS_WITHIN_S = 8.0
"""So long the first tubers of live cameras without an encoder wait until it is known how far their clocks differ: each
segmenter reports once a second."""
NEWS_NS = 500_000_000
TURNED_NS = 20_000_000
"""Belts are laid side by side by another difference once the clocks moved so far against each other. 6 mm of belt."""

AT_ONCE_S = 1.0
"""Marks that come so soon after the first one may have waited for this process."""
PLACE_SLACK_M = 0.01
ESTIMATED_SLACK_M = 0.02
"""Places are known to a few millimetres, less well where travel is estimated: this far from the watermark nothing is
committed yet. Marks keep a centimetre of their own; of 900 simulated tubers none needed more than 7 mm."""


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
    sight: CameraSight = field(default_factory=CameraSight)
    info_s: float | None = None
    lead_until_s: float = -math.inf
    encoder_m: float | None = None
    """Where a belt's own encoder stood when the newest mark came."""
    marked_s: tuple[float, int] | None = None
    """When the newest mark of this process's life came, and its capture time."""
    first_marked_s: float | None = None
    """When this process first heard a mark of it."""
    pace: float = 1.0
    """Seconds of the camera's clock in one of ours: a recording may be played at another speed."""
    keeps_pace: bool = False
    """Whether that is known. Else marks tell it, those apart that come at once after an aggregator was away."""
    _paced_from: tuple[float, int] | None = None

    def mark_came(self, captured_ns: int, now_s: float) -> None:
        """A mark that shows progress has come."""
        self.marked_s = (now_s, captured_ns)
        if self.first_marked_s is None:
            self.first_marked_s = now_s
        if self.keeps_pace:
            return
        if self._paced_from is None or now_s - self.first_marked_s < AT_ONCE_S:
            self._paced_from = self.marked_s
        since_s = now_s - self._paced_from[0]
        if since_s >= 2.0:
            self.pace = min(max((captured_ns - self._paced_from[1]) / 1e9 / since_s, 0.01), 100.0)

    def until_ns(self, now_s: float) -> int | None:
        """The camera's clock now, where no word of its own says more; None where nothing is known."""
        if self.marked_s is None:
            return None
        if self.info_s is not None and now_s - self.info_s <= INFO_AGE_S:
            return None
        came_s, captured_ns = self.marked_s
        return captured_ns + round(min(now_s - came_s, STANDS_AFTER_S) * self.pace * 1e9)

    @property
    def final(self) -> bool:
        """Its last mark said that nothing follows, or was set aside and that much of it could be read."""
        return self.sight.final or (self.mark is not None and self.mark.final)

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
            return CameraWord.ENDED.value
        if self.stalled(now_s, stall_s=stall_s):
            return CameraWord.SILENT.value
        return (CameraWord.WAITING if self.heard_s is None else CameraWord.RUNNING).value


class Cameras:
    """All cameras of a line. Without an encoder the first by name is the reference of travel, and while it sees no load
    move another one; where an encoder tells travel to some of them, the first of those is.
    """

    def __init__(self, names: tuple[str, ...], *, stall_s: float, now_s: float) -> None:
        self.names = tuple(sorted(names))
        self.states = {name: CameraState(now_s) for name in self.names}
        self.stall_s = self._stall_s = stall_s
        self._began_s: float | None = now_s
        self._line = LineTravel({name: state.curve for name, state in self.states.items()})
        self._encoder_m: float | None = None
        self._encoder_first_m: float | None = None
        self._clocks = CameraClocks()
        self._laid = True

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
            if entry.mark is not None:
                state.mark_came(entry.mark.captured_ns, now_s)
                state.encoder_m = self._encoder_m

    def travelled(self, travel: Travel) -> None:
        """An encoder says where the belt is. What a camera's own segmenter says is in its log."""
        if travel.source not in self.states and not travel.estimated:
            self._encoder_m = travel.travel_m
            if self._encoder_first_m is None:
                self._encoder_first_m = travel.travel_m

    def info(self, info: CameraInfo, now_s: float) -> None:
        """What a camera says of itself. Belt that ran under a live one since the load began, before its first frame, is
        known by our clock alone.
        """
        state = self.states.get(info.camera)
        if state is None:
            return
        known = state.sight.published
        first, before_ns = known.first_ns is None and info.first_captured_ns is not None, known.last_ns
        known.take(info)
        if first and info.live and self._began_s is not None:
            state.lead_until_s, known.lead_s = now_s + LEAD_WITHIN_S, math.inf
            if self._encoder_first_m is not None and info.first_travel_m is not None:
                known.lead_m = max(0.0, info.first_travel_m - self._encoder_first_m)
        if now_s < state.lead_until_s and self._began_s is not None:
            # What it said may have come late, and been old when it came: the least of some is the truth.
            published_s = ((info.last_captured_ns or 0) - (known.first_ns or 0)) / 1e9
            known.lead_s = min(known.lead_s, max(0.0, now_s - self._began_s - published_s))
        # One that stood still repeats an old frame when it wakes: no word of where the belt is.
        if info.state == "streaming" and (info.waits or before_ns is None or known.last_ns != before_ns):
            state.info_s = now_s
        elif info.state == "ended":
            state.info_s = math.inf

    def clock(self, camera: str, camera_s: float, *, host: str, arrived_s: float) -> int | None:
        """A live camera's clock stood at `camera_s` when a report was sent that came at `arrived_s` of ours. Returns
        what it is ahead of the first camera's, nanoseconds, where that is news; belts are laid side by side by it.
        """
        reference = self.names[0]
        if camera not in self.states:
            return None
        self._clocks.reported(camera, camera_s, host=host, arrived_s=arrived_s)
        state = self.states[camera]
        ahead_ns = 0 if camera == reference else self._clocks.ahead_ns(camera, of=reference)
        if ahead_ns is None or abs(ahead_ns - state.sight.ahead_ns) < TURNED_NS:
            return None
        before_ns, state.sight.ahead_ns = state.sight.ahead_ns, ahead_ns
        state.curve.ahead_ns = ahead_ns
        return ahead_ns if 0 in (before_ns, ahead_ns) or abs(ahead_ns - before_ns) >= NEWS_NS else None

    def _clocks_known(self, now_s: float) -> bool:
        """It is known how far live cameras' clocks differ, or no use to wait for it any longer."""
        live = [name for name, state in self.states.items() if state.sight.published.live]
        if len(live) < 2 or not self.estimated or self._clocks.known(live, of=self.names[0]):
            return True
        first_s = [s.first_marked_s for s in self.states.values() if s.first_marked_s is not None]
        return not first_s or now_s - min(first_s) >= CLOCKS_WITHIN_S

    def began(self, began_s: float) -> None:
        """When the load began, by the clock of `now_s`: before this process joined its line, or with an earlier one."""
        self._began_s = began_s

    def resumed(self, travel: TravelKnown) -> None:
        """The run was begun by an earlier process: when, our clock does not know."""
        self._began_s = None
        self._line.restored(travel)

    @property
    def running(self) -> set[str]:
        """Cameras that were heard and did not end: who marks again and again."""
        return {name for name, state in self.states.items() if state.heard_s is not None and not state.final}

    @property
    def estimated(self) -> bool:
        """Some camera's marks rest on travel that no encoder tells."""
        return any(state.mark is not None and state.mark.travel_estimated for state in self.states.values())

    @property
    def _told(self) -> str | None:
        """The first camera by name to which an encoder tells its travel: one that has none is laid by that."""
        told = (name for name in self.names if (mark := self.states[name].mark) and not mark.travel_estimated)
        return next(told, None)

    @property
    def place_slack_m(self) -> float:
        """How far from the watermark nothing is committed yet."""
        return ESTIMATED_SLACK_M if self.estimated else PLACE_SLACK_M

    @property
    def travel(self) -> TravelKnown:
        """What is known of the line's travel where it is estimated."""
        return self._line.known

    def away(self, now_s: float) -> set[str]:
        """Cameras that are silent, or whose segmenter is gone."""
        return {
            name
            for name, state in self.states.items()
            if not state.final and (state.gone_s is not None or state.stalled(now_s, stall_s=self._stall_s))
        }

    def given_up(self, now_s: float) -> set[str]:
        """Cameras that are waited for no longer."""
        return {
            name for name, state in self.states.items() if state.final or state.stalled(now_s, stall_s=self._stall_s)
        }

    def moment(self, now_s: float, *, over: bool, waiting_m: Mapping[str, float] | None = None) -> Moment:
        """Now, for the coverage; `waiting_m` as there."""
        until = {name: until for name, state in self.states.items() if (until := state.until_ns(now_s)) is not None}
        return Moment(over=over, away=self.away(now_s), until_ns=until, ran_m=self._ran_m(), waiting_m=waiting_m or {})

    def _ran_m(self) -> dict[str, float]:
        """How far the belt ran since each camera's newest mark, by an encoder of its own."""
        if self._encoder_m is None:
            return {}
        marked_m = {name: s.encoder_m for name, s in self.states.items() if not s.final and s.encoder_m is not None}
        return {name: max(0.0, self._encoder_m - m) for name, m in marked_m.items()}

    @property
    def sights(self) -> Mapping[str, CameraSight]:
        """What each camera looked at."""
        return {name: state.sight for name, state in self.states.items()}

    def presence(self, camera: str, *, alive: bool, now_s: float) -> None:
        """The liveliness token of the camera's segmenter is there or gone."""
        state = self.states[camera]
        state.gone_s = None if alive else (now_s if state.gone_s is None else state.gone_s)

    def marked(self, camera: str, mark: Mark) -> None:
        """A mark was applied."""
        state = self.states[camera]
        state.marks.append(mark)
        state.mark = mark
        state.sight.marked(mark)
        state.curve.add(mark.captured_ns, mark.travel_m, mark.frames.get(CARRIED, 0))

    def ended(self, camera: str) -> None:
        """The camera's final mark came, and nothing else of it could be read."""
        self.states[camera].sight.final = True

    def crossed(self, camera: str, x_m: float) -> None:
        """A tuber's centre crossed the centre row of `camera` there, belt coordinates."""
        self.states[camera].sight.crossed(x_m)

    def loads_change(self) -> None:
        """Loads begin and end in this run: what was looked at is told for each of them."""
        for state in self.states.values():
            state.sight.loads_change = True

    def restored(
        self, camera: str, *, marks: Sequence[Mark], curve: Sequence[tuple[int, float, int]], sight: CameraSight
    ) -> None:
        """A camera as the ledger knows it; `curve` are samples (as `TravelCurve.add` takes them), oldest first."""
        state = self.states[camera]
        state.marks, state.mark, state.sight = list(marks), marks[-1] if marks else None, sight
        if state.mark is not None and not state.final:  # tracks that wait are taken off that, not off what a stop left
            sight.complete_ns = state.mark.complete_ns
        state.curve.ahead_ns = sight.ahead_ns
        for captured_ns, travel_m, carried_ms in curve:
            state.curve.add(captured_ns, travel_m, carried_ms)

    def ran_until(self, day_ns: int, now_s: float) -> None:
        """The belt under live cameras, which stamp frames with the time of the day, ran on until then. `now_s` is the
        moment at which coverage is asked for; nothing was heard of them in this process's life.
        """
        for state in self.states.values():
            if state.mark is not None and state.sight.published.live and state.marked_s is None:
                since_s = (day_ns - state.mark.captured_ns) / 1e9
                if 0 <= since_s <= STANDS_AFTER_S:
                    state.marked_s = (now_s - since_s, state.mark.captured_ns)

    def place_x_m(
        self,
        camera: str,
        own_place_x_m: float,
        *,
        t_ns: int,
        own_travel_m: float,
        estimated: bool,
        wait: bool = True,
    ) -> float | None:
        """A place of `camera`'s by the line's travel, metres; None while not known, without `wait` as far as it is."""
        if not estimated:
            return own_place_x_m
        if not self._laid:
            return None
        travel_m = self._line.travel_m(camera, t_ns=t_ns, own_travel_m=own_travel_m, told=self._told, wait=wait)
        return None if travel_m is None else own_place_x_m + own_travel_m - travel_m

    def beyond_m(self, camera: str, place_x_m: float) -> float:
        """Belt at the end of `camera`'s log from a place of the line's on, metres; 0 where that is not known."""
        mark = self.states[camera].mark
        if mark is None:
            return 0.0
        complete_x_m = self.place_x_m(
            camera,
            mark.complete_place_x_m,
            t_ns=mark.captured_ns,
            own_travel_m=mark.travel_m,
            estimated=mark.travel_estimated,
        )
        return 0.0 if complete_x_m is None else max(0.0, place_x_m - complete_x_m)

    def says(self, now_s: float) -> Mapping[str, str]:
        """One word for each camera."""
        return {name: state.says(now_s, stall_s=self._stall_s) for name, state in self.states.items()}

    def watermark_x_m(self, now_s: float, *, wait: bool = True) -> float:
        """Nothing more can come at this place or further along: infinite while some camera has said nothing yet.

        Cameras that ended or stalled hold no one up; where all stalled, or with `wait` false, the one that got
        farthest decides alone.
        """
        self._laid = self._clocks_known(now_s)
        stalled = {name for name, state in self.states.items() if state.stalled(now_s, stall_s=self._stall_s)}
        for name, state in self.states.items():
            state.curve.closed = state.final or name in stalled
        if self._laid and self._told is None:
            self._line.follow()
            self._lay()
        complete = {name: self._complete_x_m(name) for name in self.names}
        expected = [complete[name] for name in self.names if name not in stalled]
        if not complete:
            return math.inf
        return max(expected) if expected and wait else min(complete.values())

    def _lay(self) -> None:
        """Tell what each camera looked at in terms of the line's travel, once that is not the first camera's own."""
        for name, state in self.states.items() if self._line.turns else ():
            for t_ns, _ in state.sight.curve[len(state.sight.line_m) :]:
                line_m = self._line.travel_m(name, t_ns=t_ns, own_travel_m=state.curve.at(t_ns - state.curve.ahead_ns))
                if line_m is None:
                    break
                state.sight.line_m.append(line_m)

    def _complete_x_m(self, camera: str) -> float:
        """Where `camera` is complete, by its newest mark whose moment the line's travel reaches.

        One that ended is complete everywhere only then: a recording that is read faster than the reference's ends while
        its last tracks have no place yet, and what they belong to must not be committed without them.
        """
        state = self.states[camera]
        if state.final and not state.marks:
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
                newest = at == len(state.marks) - 1
                del state.marks[:at]
                return -math.inf if state.final and newest else place
        return math.inf
