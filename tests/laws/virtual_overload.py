"""A live camera that sees more tubers than its regressors can weigh, on a clock of ours.

`CameraRun` with its dispatcher, weighing and log is the real thing. Only the belt is made up: tubers close at an even
rate, each with three views, and regressors take a given time for a view.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages import Frame, Track, View, Weight
from segmenter.camera_run import CameraRun, RunSettings
from segmenter.dispatch.dispatcher import DispatchSettings
from segmenter.pipeline import ClosedTrack, Settings, StepResult
from tests.segmenter.segmenter_scene import SMALL

RUN, CAMERA = "r1", "front"
VIEWS = 3
SPEED_MPS = 0.3
LIVE = RunSettings(
    core=Settings(), dispatch=DispatchSettings(shed_over=256), weigh_deadline_s=60.0, max_pending_views=256, window=1
)
_DEPTH = np.ones((2, 2), np.uint16)
_POSE = straight_down_belt_from_camera(0.46)
_TRACK = Track(
    track_id="", crossed_ns=0, crossed_x_m=0.0, y_m=0.0, travel_m=0.0, travel_estimated=False, frames=20, first_seq=0,
    last_seq=0, length_mm=70.0, width_mm=60.0, height_mm=50.0, visible_volume_ml=150.0, whole=True, views_sent=0,
    views=(), views_lost={},
)  # fmt: skip


def view(track: int, rank: int, captured_ns: int) -> View:
    """One of the views of a tuber."""
    track_id = f"{RUN}/{CAMERA}/{track}"
    return View(f"{track_id}/{rank}", track_id, CAMERA, RUN, rank, captured_ns, rank, 0.001, SMALL, 0, 0, _DEPTH, _POSE)


class MadeUpBelt:
    """What a segmenting core says of a belt on which `per_s` tubers a second close; the same in every history."""

    estimated = False
    unfollowed_ms = carried_ms = 0

    def __init__(self, per_s: float) -> None:
        self.per_s = per_s
        self.closed = 0
        self.now_s = 0.0

    @property
    def travel_m(self) -> float:
        return SPEED_MPS * self.now_s

    looked_at_m = travelled_m = travel_m
    longest_step_m = 0.0

    def step(self, frame: Frame) -> StepResult:
        before_m, self.now_s = self.travel_m, frame.captured_ns / 1e9
        self.longest_step_m = max(self.longest_step_m, self.travel_m - before_m)
        due, closed = int(self.now_s * self.per_s), []
        for number in range(self.closed, due):
            track = replace(
                _TRACK, track_id=f"{RUN}/{CAMERA}/{number}", crossed_ns=frame.captured_ns, travel_m=self.travel_m
            )
            closed.append(ClosedTrack(track, tuple(view(number, rank, frame.captured_ns) for rank in range(VIEWS))))
        self.closed = due
        return StepResult(self.travel_m, False, len(closed), tuple(closed))

    def finish(self) -> list[ClosedTrack]:
        return []

    def track_counts(self) -> dict[str, int]:
        return {"opened": self.closed, "counted": self.closed, "open": 0}

    def complete_travel_m(self) -> float:
        return math.nextafter(self.travel_m, -math.inf)

    def complete_ns(self, complete_travel_m: float) -> int:
        return round(self.now_s * 1e9) - 1

    def row_place_m(self, travel_m: float) -> float:
        return -travel_m


@dataclass(slots=True)
class Worker:
    """A regressor that takes `takes_s` for a view, one after the other, and holds what it has while it sleeps."""

    takes_s: float
    queue: list[View] = field(default_factory=list)
    free_s: float = 0.0
    weighed: int = 0

    def answers(self, name: str, until_s: float, *, refuse_first: bool) -> list[Weight]:
        """All it has done by `until_s`."""
        done = []
        while self.queue and self.free_s + self.takes_s <= until_s:
            self.free_s += self.takes_s
            self.weighed += 1
            done.append(_weight(self.queue.pop(0), name, refuse_first=refuse_first))
        return done


def _weight(view: View, name: str, *, refuse_first: bool) -> Weight:
    common = (view.view_id, view.track_id, CAMERA, RUN, view.seq)
    if refuse_first and view.rank == 0:
        return Weight(*common, "refused", None, None, None, "pointraft", "m", (), name, "few_points")
    return Weight(*common, "weighed", 100.0, 90.0, 110.0, "pointraft", "m", (), name)


@dataclass(slots=True)
class FloodedLine:
    """One camera's run and its regressors, turn by turn; a turn is what the segmenter takes for a frame."""

    per_s: float
    takes_s: float
    workers: int
    turn_s: float
    settings: RunSettings = LIVE
    refuse_first: bool = False
    confirms_per_s: float = math.inf
    """Log entries that the aggregator takes."""
    now_s: float = 0.0
    frames: int = 0
    asleep_until_s: float = 0.0
    most_outstanding: int = 0
    latest_log_s: float = 0.0
    run: CameraRun = field(init=False)
    belt: MadeUpBelt = field(init=False)
    crew: dict[str, Worker] = field(init=False)
    logged: list[Track] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.run = CameraRun(CAMERA, RUN, self.settings, None)
        self.belt = MadeUpBelt(self.per_s)
        self.run.core = self.belt  # type: ignore[assignment]
        self.run.open()
        self.crew = {f"w{i}": Worker(self.takes_s) for i in range(self.workers)}

    def turn(self) -> None:
        """A frame, the answers that came meanwhile, and whatever is due."""
        self.now_s += self.turn_s
        captured_ns = round(self.now_s * 1e9)
        self.run.frame(_frame(self.frames, captured_ns), self.now_s)
        self.frames += 1
        for name, worker in self.crew.items():
            if self.now_s < self.asleep_until_s:
                worker.free_s = self.now_s
                continue
            for weight in worker.answers(name, self.now_s, refuse_first=self.refuse_first):
                self.run.weight(weight)
        for name, sent in self.run.tick(self.now_s, set(self.crew)):
            worker = self.crew[name]
            worker.free_s = worker.free_s if worker.queue else self.now_s
            worker.queue.append(sent)
        self.most_outstanding = max(self.most_outstanding, self.run.dispatcher.outstanding)
        for entry in self.run.log.due(self.now_s):
            if entry.track is not None:
                self.logged.append(entry.track)
                self.latest_log_s = max(self.latest_log_s, self.now_s - entry.track.crossed_ns / 1e9)
        self.run.log.commit(round(min(self.run.log.newest, self.confirms_per_s * self.now_s)))

    def run_for(self, seconds: float) -> None:
        """Let that much of the virtual clock pass."""
        for _ in range(round(seconds / self.turn_s)):
            self.turn()

    @property
    def capacity_per_s(self) -> float:
        """Views a second that all regressors together can weigh."""
        return self.workers / self.takes_s

    @property
    def never_weighed(self) -> list[Track]:
        """Tubers in the log without any view weighed."""
        return [track for track in self.logged if not track.views]

    @property
    def lost(self) -> dict[str, int]:
        """Views lost, by reason."""
        return dict(self.run.dispatcher.lost)


_EMPTY = np.zeros((SMALL.height, SMALL.width), np.uint16)


def _frame(seq: int, captured_ns: int) -> Frame:
    return Frame(CAMERA, RUN, seq, captured_ns, None, 0.001, SMALL, None, _EMPTY)
