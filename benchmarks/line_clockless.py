"""A whole line over a simulated belt on a virtual clock: what its rules and its bursts cost, whatever the machine does.

    python -m benchmarks line_clockless RECORDING [--laps 2] [--frame-ms 25] [--view-ms 11]

Cores of the cameras, dispatch, weighing, log, marks and the aggregator's core are the real ones, as a live line has
them. Time is made up: two cores, shared by the processes as the kernel shares them by `nice`; a frame, a view and a
commit take the stated processor time. Regressors answer without weighing. Every run gives the same figures.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from aggregator.core.committed import CommittedTuber
from aggregator.core.machine import Aggregation
from aggregator.opening import LIVE_REACH_MM
from benchmarks.line_watch import percentile
from benchmarks.options import above_zero, parser_of, whole_number
from conveyor.config import LineConfig
from conveyor.config_camera import CameraConfig
from conveyor.formats import camera_names, open_source
from conveyor.messages import Frame, Track, TrackEntry, View, Weight
from segmenter.camera_run import CameraRun
from segmenter.setup import run_settings

RUN = "virtual"
TICK_S = 0.001
POLL_S = 0.004
LINK_S = 0.001
DISK_S = 0.003
CORES = 2.0
OTHERS_CORES = 0.25
"""Cameras, router and aggregator, spread over time."""
NICED = 0.33
"""Share of a regressor (nice 5) beside a segmenter: 335 to 1024 in the kernel's table."""


@dataclass(frozen=True, slots=True)
class Costs:
    """Seconds of processor time."""

    frame_s: float
    view_s: float
    commit_interval_s: float


class NothingBefore:
    """An empty ledger."""

    def near(self, low_x_m: float, high_x_m: float) -> Sequence[CommittedTuber]:
        return ()

    def knows_track(self, track_id: str) -> bool:
        return False

    def entry_checksum(self, camera: str, n: int) -> int | None:
        return None


@dataclass(slots=True)
class Camera:
    """A segmenter's process: its run, the frames that wait, and what it is at."""

    run: CameraRun
    frames: deque[Frame] = field(default_factory=deque)
    weights: deque[tuple[float, Weight]] = field(default_factory=deque)
    left_s: float = 0.0
    current: Frame | None = None
    next_turn_s: float = 0.0


@dataclass(slots=True)
class Regressor:
    """A regressor's process: first come, first weighed."""

    views: deque[tuple[float, View]] = field(default_factory=deque)
    left_s: float = 0.0
    current: View | None = None
    weighed: int = 0


class VirtualLine:
    """One tick after the other; everything between two ticks takes no time."""

    def __init__(self, recording: Path, costs: Costs, *, laps: int, regressors: int = 2) -> None:
        names = camera_names(recording)
        config = LineConfig(cameras={name: CameraConfig(waits=False) for name in names})
        self.costs = costs
        self.config = config
        self.cameras = {name: Camera(CameraRun(name, RUN, run_settings(config, name), None)) for name in names}
        for name, camera in self.cameras.items():
            camera.run.open()
            camera.frames.extend(_frames(recording, name, laps=laps))
        self.start_ns = min(camera.frames[0].captured_ns for camera in self.cameras.values())
        self.end_ns = max(camera.frames[-1].captured_ns for camera in self.cameras.values())
        self.crew = {f"r{n}": Regressor() for n in range(regressors)}
        self.aggregation = Aggregation(
            RUN, cameras=list(names), merge_gate_mm=config.aggregator.merge_gate_mm, camera_stall_s=10.0,
            committed=NothingBefore(), now_s=0.0, reach_mm=LIVE_REACH_MM,
        )  # fmt: skip
        self.now_s = 0.0
        self.entries: deque[tuple[float, TrackEntry]] = deque()
        self.logged: dict[str, tuple[float, Track]] = {}
        self.sent: dict[str, float] = {}
        self.waits: dict[str, list[float]] = {hop: [] for hop in ("view sent", "logged", "crossing to ledger")}
        self._commit_s = 0.0

    def run(self) -> None:
        """Until the belt ends."""
        while self.now_s < (self.end_ns - self.start_ns) / 1e9:
            self._share()
            for camera in self.cameras.values():
                self._turn(camera)
            for name, regressor in self.crew.items():
                self._weigh(name, regressor)
            if self.now_s >= self._commit_s:
                self._commit()
            self.now_s += TICK_S

    def _share(self) -> None:
        """The cores in this tick, to who has work: by weight, one core at most for each."""
        wanting: list[tuple[float, Camera | Regressor]] = []
        for camera in self.cameras.values():
            if camera.current is None and camera.frames and self._arrived(camera.frames[0]):
                camera.current, camera.left_s = camera.frames.popleft(), self.costs.frame_s
            if camera.current is not None:
                wanting.append((1.0, camera))
        for regressor in self.crew.values():
            if regressor.current is None and regressor.views and regressor.views[0][0] <= self.now_s:
                regressor.current, regressor.left_s = regressor.views.popleft()[1], self.costs.view_s
            if regressor.current is not None:
                wanting.append((NICED, regressor))
        left, weights = CORES - OTHERS_CORES, sum(weight for weight, _ in wanting)
        for weight, process in sorted(wanting, key=lambda item: -item[0]):
            share = min(1.0, left * weight / weights)
            left, weights = left - share, weights - weight
            process.left_s -= share * TICK_S

    def _arrived(self, frame: Frame) -> bool:
        return (frame.captured_ns - self.start_ns) / 1e9 + LINK_S <= self.now_s

    def _turn(self, camera: Camera) -> None:
        """What the segmenter's process does between two frames."""
        if camera.current is not None:
            if camera.left_s > 0:
                return
            camera.run.frame(camera.current, self.now_s)
            camera.current = None
        elif self.now_s < camera.next_turn_s:
            return
        camera.next_turn_s = self.now_s + POLL_S
        while camera.weights and camera.weights[0][0] <= self.now_s:
            camera.run.weight(camera.weights.popleft()[1])
        for worker, view in camera.run.tick(self.now_s, set(self.crew)):
            self.sent.setdefault(view.track_id, self.now_s)
            self.crew[worker].views.append((self.now_s + LINK_S, view))
        for entry in camera.run.log.due(self.now_s):
            self.entries.append((self.now_s + DISK_S + LINK_S, entry))
            if entry.track is not None:
                self.logged[entry.track.track_id] = (self.now_s, entry.track)

    def _weigh(self, name: str, regressor: Regressor) -> None:
        view = regressor.current
        if view is not None and regressor.left_s <= 0:
            regressor.current = None
            regressor.weighed += 1
            self.cameras[view.camera].weights.append((self.now_s + LINK_S, _weight(view, name)))

    def _commit(self) -> None:
        self._commit_s = self.now_s + self.costs.commit_interval_s
        while self.entries and self.entries[0][0] <= self.now_s:
            entry = self.entries.popleft()[1]
            self.aggregation.receive(entry, now_s=self.now_s)
            self.cameras[entry.camera].run.log.commit(entry.n)
        for tuber in self.aggregation.commit(now_s=self.now_s).tubers:
            last_s, track = max((self.logged[track] for track in tuber.tracks), key=lambda item: item[0])
            crossed_s = (track.crossed_ns - self.start_ns) / 1e9
            self.waits["crossing to ledger"].append(self.now_s + DISK_S - crossed_s)
            self.waits["logged"].append(last_s - crossed_s)
            if track.track_id in self.sent:
                self.waits["view sent"].append(self.sent[track.track_id] - crossed_s)


def _frames(recording: Path, camera: str, *, laps: int) -> list[Frame]:
    """The recording's frames, laid end to end, as one that never stops."""
    once = [
        replace(item, color_jpeg=None)
        for item in open_source(recording, camera=camera, ignore_masks=True).frames(run=RUN)
        if isinstance(item, Frame)
    ]
    first, last, steps = once[0], once[-1], len(once) - 1
    lap_ns = (last.captured_ns - first.captured_ns) * (steps + 1) // steps
    lap_m = ((last.travel_m or 0.0) - (first.travel_m or 0.0)) * (steps + 1) / steps
    return [
        replace(
            frame,
            seq=lap * len(once) + at,
            captured_ns=frame.captured_ns + lap * lap_ns,
            travel_m=None if frame.travel_m is None else frame.travel_m + lap * lap_m,
        )
        for lap in range(laps)
        for at, frame in enumerate(once)
    ]


def _weight(view: View, name: str) -> Weight:
    common = (view.view_id, view.track_id, view.camera, view.run, view.seq)
    return Weight(*common, "weighed", 100.0, 90.0, 110.0, "pointraft", "m", (), name)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the belt and print one row."""
    parser = parser_of("line_clockless", __doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--laps", type=whole_number(1), default=2)
    parser.add_argument("--frame-ms", type=above_zero, default=25.0)
    parser.add_argument("--view-ms", type=above_zero, default=11.0)
    options = parser.parse_args(arguments)
    interval_s = LineConfig(cameras={"front": CameraConfig()}).aggregator.commit_interval_s
    line = VirtualLine(
        options.recording, Costs(options.frame_ms / 1000, options.view_ms / 1000, interval_s), laps=options.laps
    )
    line.run()
    tracks = sum(camera.run.counts()["tracks"]["counted"] for camera in line.cameras.values())
    weighed = sum(regressor.weighed for regressor in line.crew.values())
    print("| hop, from the crossing | p50 s | p90 s | p99 s | tubers |\n| --- | --- | --- | --- | --- |")
    for hop, found in line.waits.items():
        told = " | ".join(f"{percentile(found, share):.3f}" for share in (0.5, 0.9, 0.99))
        print(f"| {hop} | {told} | {len(found)} |")
    print(f"\n{tracks} tracks, {weighed / tracks:.2f} views weighed of each.")
    return 0
