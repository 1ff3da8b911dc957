"""The whole graph without processes: the real cores of every role, a clock of ours, and links that lose things.

Segmentation itself is remembered: it gives the same answer to the same frames bit for bit, so each frame is segmented
once and its answer is told again in every history. Everything behind it is the real thing: dispatcher, weighing, log on
disk, aggregation, ledger on disk, and the camera's window.
"""

from __future__ import annotations

import random
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from aggregator.core.machine import Aggregation
from aggregator.ledger.audit import Audit, audit_run
from aggregator.ledger.export import canonical_lines
from aggregator.ledger.schema import TUBER
from aggregator.ledger.writer import Ledger
from camera_sim.flow import SendWindow
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages import CameraInfo, Committed, Frame, FrameProgress, TrackEntry, View, Weight
from segmenter.camera_run import CameraRun, RunSettings
from segmenter.dispatch.dispatcher import DispatchSettings
from segmenter.log_store import LogStore
from segmenter.pipeline import Segmenter, Settings, StepResult
from tests.laws.faults import Died, Faults, Fuse, Link
from tests.segmenter.segmenter_scene import SMALL, Scene, scattered

RUN = "r1"
NAMES = ("left", "right")
REGRESSORS = ("a", "b")
FRAMES = 46
STEP_M = 0.0155
WEIGHING_S = 0.06
RESTART_S = 0.6
"""Messages may be under way for longer: what was sent to a dead process reaches its successor."""
PROGRESS_EVERY_S = 0.2
TURN_S = 0.04
MOST_LEAVES = 25
"""A history has twelve events; each may take a view from one regressor and show that another one stood still at it."""
SETTINGS = RunSettings(
    core=Settings(views_per_tuber=2),
    dispatch=DispatchSettings(deadline_s=1.0, max_attempts=MOST_LEAVES),
    weigh_deadline_s=3600.0,
    max_pending_views=20,
    window=1,
    replays=True,
)


@dataclass(frozen=True, slots=True)
class Moment:
    """What the segmenting core says after a frame."""

    result: StepResult
    travel_m: float
    looked_at_m: float
    travelled_m: float
    complete_m: float
    complete_ns: int
    counts: dict[str, int]


class RememberedCore:
    """A `Segmenter` whose answers were written down."""

    estimated = False
    unfollowed_ms = carried_ms = 0

    def __init__(self, memory: Memory) -> None:
        self._memory = memory
        self._done = 0
        first = memory.moments[0]
        self.travel_m, self.looked_at_m, self.travelled_m = first.travel_m, first.looked_at_m, first.travelled_m

    @property
    def _now(self) -> Moment:
        return self._memory.moments[max(self._done - 1, 0)]

    def step(self, frame: Frame) -> StepResult:
        assert frame.seq == self._done, "a replay skipped a frame"
        self._done += 1
        now = self._now
        self.travel_m, self.looked_at_m, self.travelled_m = now.travel_m, now.looked_at_m, now.travelled_m
        return now.result

    def finish(self) -> list[Any]:
        return list(self._memory.at_end) if self._done else []

    def take_foreign(self) -> tuple[()]:
        """Nothing that was refused at the end is remembered."""
        return ()

    def track_counts(self) -> dict[str, int]:
        return dict(self._memory.last_counts if self._done == FRAMES else self._now.counts)

    def complete_travel_m(self) -> float:
        return self._now.complete_m

    def complete_ns(self, complete_travel_m: float) -> int:
        return self._memory.core.complete_ns(complete_travel_m) if self._done == FRAMES else self._now.complete_ns

    def row_place_m(self, travel_m: float) -> float:
        return self._memory.core.row_place_m(travel_m)


@dataclass(slots=True)
class Memory:
    """One camera's frames and what the core said of each."""

    frames: list[Frame]
    moments: list[Moment]
    at_end: list[Any]
    last_counts: dict[str, int]
    core: Segmenter


@cache
def remembered(camera: str) -> Memory:
    """Two cameras side by side over the same tubers; the right one sits further along."""
    pose = straight_down_belt_from_camera(0.46)
    if camera == "right":
        pose[:2, 3] += (0.06, 0.03)
    scene = Scene(scattered(9, seed=5), noise_m=0.001, belt_from_camera=pose, seed=len(camera))
    core = Segmenter(SETTINGS.core)
    frames, moments = [], []
    for seq in range(FRAMES):
        frames.append(replace(scene.frame(seq, seq * STEP_M), camera=camera, run=RUN))
        result = core.step(frames[-1])
        complete_m = core.complete_travel_m()
        moments.append(
            Moment(
                result,
                core.travel_m,
                core.looked_at_m,
                core.travelled_m,
                complete_m,
                core.complete_ns(complete_m),
                core.track_counts(),
            )
        )
    at_end = core.finish()
    return Memory(frames, moments, at_end, core.track_counts(), core)


class Camera:
    """A replaying camera: `CameraNode` without its sockets."""

    def __init__(self, name: str, window: int) -> None:
        self.name = name
        self.frames = remembered(name).frames
        self.size = window
        self.window = SendWindow(window)
        self.done_seq = -1
        self.next = 0
        self.last = -1
        self.after = -1
        self.started = False

    def turn(self, words: list[FrameProgress], now_s: float) -> Iterator[Frame]:
        """Frames to send now, after the segmenter's `words`."""
        for word in words:
            if not self.started or word.done_seq < self.done_seq:
                self.window = SendWindow(self.size)
                self.next, self.after = word.done_seq + 1, word.done_seq
                self.last = max(self.last, word.done_seq)
            self.started = True
            self.done_seq = word.done_seq
            self.window.done(word.done_seq, now_s)
        if words:
            yield from self.window.to_resend(now_s)
        while self.started and self.next < len(self.frames) and self.window.has_room:
            frame = replace(self.frames[self.next], after_seq=self.after)
            self.window.sent(frame, now_s)
            self.next, self.last, self.after = self.next + 1, max(self.last, frame.seq), frame.seq
            yield frame

    def info(self) -> CameraInfo:
        ended = self.next == len(self.frames) and not self.window.in_flight
        state = "ended" if ended else "streaming"
        last = self.last if self.last >= 0 else None
        return CameraInfo(
            self.name, RUN, state, "virtual", 30.0, True, SMALL, 0.001, 0 if last is not None else None, last,
            self.last + 1, {},
        )  # type: ignore[arg-type]  # fmt: skip


@dataclass(slots=True)
class Regressor:
    """Weighs one view after the other; the same view always weighs the same, and is not weighed twice by one."""

    queue: list[View] = field(default_factory=list)
    free_s: float = 0.0
    awake_s: float = 0.0
    alive_s: float = 0.0
    weighing_s: float = WEIGHING_S
    answered: set[str] = field(default_factory=set)

    def turn(self, name: str, now_s: float) -> Iterator[Weight]:
        while self.queue and now_s >= max(self.free_s, self.awake_s, self.alive_s):
            view = self.queue.pop(0)
            if view.view_id not in self.answered:
                self.free_s = now_s + self.weighing_s
                self.answered.add(view.view_id)
            grams = 40.0 + zlib.crc32(view.view_id.encode()) % 300
            yield Weight(
                view.view_id, view.track_id, view.camera, RUN, view.seq, "weighed", grams, 0.9 * grams, 1.1 * grams,
                "pointraft", "m", (), name,
            )  # fmt: skip


class Graph:
    """Two cameras, their segmenters, two regressors and the aggregator, turn by turn."""

    def __init__(self, folder: Path, seed: int, *, window: int = 1, settings: RunSettings = SETTINGS) -> None:
        self.folder = folder
        self.settings = replace(settings, window=window)
        self.now_s = 0.0
        self.window = window
        self.faults = Faults()
        self.cameras = {name: Camera(name, window) for name in NAMES}
        self.regressors = {name: Regressor() for name in REGRESSORS}
        self.segmenters: dict[str, CameraRun | None] = dict.fromkeys(NAMES)
        self.segmenter_starts_s = dict.fromkeys(NAMES, 0.0)
        self.fuses = {name: Fuse() for name in (*NAMES, *REGRESSORS, "aggregator")}
        self.promised = dict.fromkeys(NAMES, 0)
        self.lost: dict[str, int] = {}
        self.deaths: dict[str, int] = {}
        self._said: dict[str, tuple[float, FrameProgress | None]] = dict.fromkeys(NAMES, (0.0, None))
        self._committed: dict[str, Committed | None] = dict.fromkeys(NAMES)
        self._random = links = random.Random(seed)
        self._frames = {name: Link[Frame](links.randrange(1 << 30), self.faults) for name in NAMES}
        self._progress = {name: Link[FrameProgress](links.randrange(1 << 30), self.faults) for name in NAMES}
        self._entries = Link[TrackEntry](links.randrange(1 << 30), self.faults)
        self._views = {name: Link[View](links.randrange(1 << 30), self.faults) for name in REGRESSORS}
        self._weights = Link[Weight](links.randrange(1 << 30), self.faults)
        self._acks = Link[Committed](links.randrange(1 << 30), self.faults)
        self.ledger = self._open_ledger()
        self.aggregation = self._aggregation()
        self.finished = False
        self._commit_s = 0.0

    def _open_ledger(self) -> Ledger:
        return Ledger(self.folder / "ledger.db", step=self.fuses["aggregator"].burn).__enter__()

    def _aggregation(self) -> Aggregation:
        restored = self.ledger.open_run(
            RUN, line="virtual", cameras=list(NAMES), version="1", started_ns=0, may_be_finished=True
        )
        return Aggregation(
            RUN, cameras=NAMES, merge_gate_mm=30, camera_stall_s=3600.0, committed=self.ledger.committed(RUN),
            now_s=self.now_s, restored=restored, count=self._count,
        )  # fmt: skip

    def _count(self, name: str) -> None:
        self.lost[name] = self.lost.get(name, 0) + 1

    def close(self) -> None:
        self.ledger.__exit__(None, None, None)
        for run in self.segmenters.values():
            if run is not None:
                run.close()

    def kill_segmenter(self, name: str) -> None:
        """It is gone with everything it held in memory, and back a moment later."""
        if (run := self.segmenters[name]) is not None:
            run.close()
        self.segmenters[name] = None
        self.segmenter_starts_s[name] = self.now_s + RESTART_S

    def kill_regressor(self, name: str) -> None:
        self.regressors[name] = Regressor(alive_s=self.now_s + RESTART_S)

    def freeze_regressor(self, name: str, seconds: float) -> None:
        """It holds its work and answers later, when somebody else has already done it."""
        self.regressors[name].awake_s = self.now_s + seconds

    def kill_camera(self, name: str) -> None:
        self.cameras[name] = Camera(name, self.window)

    def kill_aggregator(self) -> None:
        """What was not written is gone; it starts again from the ledger alone."""
        self.ledger.__exit__(None, None, None)
        self.ledger = self._open_ledger()
        self.aggregation = self._aggregation()
        for name, n in self.aggregation.applied().items():
            assert n >= self.promised[name], f"{name}: {self.promised[name]} entries were acknowledged, {n} are there"

    def turn(self) -> None:
        """40 ms of everybody's work."""
        self.now_s += TURN_S
        for name in NAMES:
            self._camera_turn(name)
            self._mortal(
                name, lambda name=name: self._segmenter_turn(name), lambda name=name: self.kill_segmenter(name)
            )  # type: ignore[misc]
        for name in REGRESSORS:
            self._mortal(
                name, lambda name=name: self._regressor_turn(name), lambda name=name: self.kill_regressor(name)
            )  # type: ignore[misc]
        for weight in self._weights.take(self.now_s):
            if (run := self.segmenters[weight.camera]) is not None:
                run.weight(weight)
        self._mortal("aggregator", self._aggregator_turn, self.kill_aggregator)

    def _mortal(self, name: str, work: Callable[[], None], bury: Callable[[], None]) -> None:
        """A turn of a process that may die at any of its writes."""
        try:
            work()
        except Died as died:
            self.deaths[f"{name}: {died}"] = self.deaths.get(f"{name}: {died}", 0) + 1
            bury()

    def _camera_turn(self, name: str) -> None:
        for frame in self.cameras[name].turn(self._progress[name].take(self.now_s), self.now_s):
            self._frames[name].put(frame, self.now_s)

    def _regressor_turn(self, name: str) -> None:
        regressor = self.regressors[name]
        regressor.queue += self._views[name].take(self.now_s)
        for weight in regressor.turn(name, self.now_s):
            self.fuses[name].burn("answer")
            self._weights.put(weight, self.now_s)

    def _segmenter_turn(self, name: str) -> None:
        run, fuse = self.segmenters[name], self.fuses[name]
        if run is None:
            if self.now_s < self.segmenter_starts_s[name]:
                self._frames[name].take(self.now_s)
                return
            run = self._start_segmenter(name)
        for frame in self._frames[name].take(self.now_s):
            run.frame(frame, self.now_s)
        if not self.faults.cut:
            run.info(self.cameras[name].info(), self.now_s)
        for committed in self._acks.take(self.now_s):
            self._committed[committed.camera] = committed
        if (known := self._committed[name]) is not None:
            run.log.commit(known.n)
        present = {n for n, r in self.regressors.items() if self.now_s >= r.alive_s and not self.faults.cut}
        for regressor, view in run.tick(self.now_s, present):
            fuse.burn("view")
            self._views[regressor].put(view, self.now_s)
        for entry in run.log.due(self.now_s):
            fuse.burn("entry")
            self._entries.put(entry, self.now_s)
        progress, (said_s, said) = run.progress(), self._said[name]
        if progress != said or self.now_s - said_s >= PROGRESS_EVERY_S:
            fuse.burn("progress")
            self._said[name] = (self.now_s, progress)
            self._progress[name].put(progress, self.now_s)

    def _start_segmenter(self, name: str) -> CameraRun:
        run = self.segmenters[name] = CameraRun(name, RUN, self.settings, self.folder / f"{name}.db")
        run.core = RememberedCore(remembered(name))  # type: ignore[assignment]
        run.open()
        run.ended = run.log.last_mark is not None and run.log.last_mark.final
        assert isinstance(run.log.store, LogStore)
        run.log.store.step = self.fuses[name].burn
        return run

    def _aggregator_turn(self) -> None:
        for entry in self._entries.take(self.now_s):
            self.aggregation.receive(entry, now_s=self.now_s)
        if self.now_s - self._commit_s < 0.2:
            return
        self._commit_s = self.now_s
        batch = self.aggregation.commit(now_s=self.now_s)
        if not batch.empty:
            self.ledger.write(RUN, batch)
        self.finished = self.aggregation.finished
        for name, n in self.aggregation.applied().items():
            self.promised[name] = max(self.promised[name], n)
            self.fuses["aggregator"].burn("acknowledgement")
            self._acks.put(Committed(name, RUN, n), self.now_s)

    def tubers(self) -> list[tuple[Any, ...]]:
        """The ledger's rows of tubers, in order."""
        return list(self.ledger.view.rows(TUBER, "ORDER BY tuber_id"))

    def canonical(self) -> list[str]:
        row = self.ledger.run_row(RUN)
        assert row is not None
        return list(canonical_lines(self.ledger.view, row))

    def audit(self) -> Audit:
        row = self.ledger.run_row(RUN)
        assert row is not None
        return audit_run(self.ledger.view, row)


def true_places() -> np.ndarray[Any, np.dtype[np.float64]]:
    """(N, 2) float64 places of the tubers on the belt, metres."""
    return np.array([[body.place_x_m, body.y_m] for body in scattered(9, seed=5)])
