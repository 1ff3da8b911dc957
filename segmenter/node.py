"""The segmenter's process: one camera's frames in; views, the camera's log and its progress out."""

from __future__ import annotations

import threading
import time
from collections import deque
from contextlib import ExitStack
from dataclasses import replace

from conveyor import topics
from conveyor.access import known_nodes
from conveyor.belt_findings import belt_findings
from conveyor.camera_clock import AT_START_GAUGE, CameraClock
from conveyor.config import LineConfig
from conveyor.counters import is_told
from conveyor.delivery import (
    KeptPublisher,
    KeptSubscriber,
    LatestPublisher,
    LatestSubscriber,
    Presence,
    ReliablePublisher,
    ReliableSubscriber,
)
from conveyor.delivery.endpoint import Endpoint
from conveyor.direct import DirectLink, direct_endpoint
from conveyor.frame_ring import RingInlet, ring_path
from conveyor.kernels import compiled_once
from conveyor.messages import CameraInfo, Committed, Frame, Weight
from conveyor.node import Node
from conveyor.processors import Processors
from conveyor.reasons import FrameDrop
from segmenter.age import FrameAge
from segmenter.camera_run import CameraRun
from segmenter.frame.watch import BeltWatch
from segmenter.in_view import tracks_in_view
from segmenter.memory import CameraMemory
from segmenter.results import StepResult
from segmenter.setup import log_path, run_settings
from segmenter.state_lock import only_here
from segmenter.warmup import warm_up

PROGRESS_EVERY_S = 0.2
TRAVEL_EVERY_S = 0.1
IN_VIEW_EVERY_S = 0.2
REPORT_EVERY_S = 0.2
PICTURE_EVERY_S = 0.25
IDLE_POLL_S = 0.02
BUSY_POLL_S = 0.004
COMMITTED_WAIT_S = 0.5
RUNS_REMEMBERED = 64
"""Older runs that are committed and closed: a frame of them that comes late does not begin them again."""
EXPLAINED, UNLIKE = "belt_explained", "camera_unlike"
"""Among what was told of the belt: that it was seen elsewhere because the camera's depth had drifted; and of the
camera: that it is another than it was."""


class SegmenterNode:
    """The shell: sockets and clocks around `CameraRun`. A new run id from the camera opens a new run; older runs live
    on until their logs are committed.
    """

    def __init__(self, config: LineConfig, camera: str, run: str) -> None:
        self._config = config
        self._camera = camera
        source = config.camera(camera)
        self._waits = source.waits and source.source == "recording"  # a device waits for no one
        self._node = Node("segmenter", camera, config=config, run=run, announce=False)
        self._runs: dict[str, CameraRun] = {}
        self._current: CameraRun
        self._memory = CameraMemory(config, camera, self._node.log)
        self._over: deque[str] = deque(maxlen=RUNS_REMEMBERED)
        self._speed = 1.0 if source.of_today else source.speed
        self._age = FrameAge(self._speed)
        self._processors = Processors()
        self._clock = CameraClock(self._speed)
        self._oldest_ms = 0.0
        self._overwritten = 0
        self._progress_s = self._travel_s = self._in_view_s = self._picture_s = self._reported_s = 0.0
        self._sent_progress: object = None
        self._works: dict[str, LatestPublisher] = {}
        self._belt = BeltWatch()
        self._belt_told: set[str] = set()
        self._unanswered = 0
        self._aggregator_came = threading.Event()
        self._told_finished = ""

    def run(self) -> None:
        """Work until stopped."""
        with compiled_once("frames"):
            warm_up(self._config.segmenter.pixel_mm)
        with self._node as node, ExitStack() as stack:
            stack.enter_context(only_here(self._config.segmenter.state_dir, f"{self._config.name}.{self._camera}"))
            self._open_links(node, stack)
            self._memory.look(go_on=self._goes_on)
            try:
                self._open_run(node.run)
                node.announce()
                while not node.stop.is_set():
                    self._turn()
                    node.progress()
            finally:
                self._remember()
                for camera_run in self._runs.values():
                    camera_run.close()

    def _goes_on(self) -> bool:
        """Another frame may be looked at before the first one is counted."""
        self._node.progress()
        self._node.counters.add("frames_looked_first")
        return not self._node.stop.is_set()

    def _remember(self) -> None:
        """The newest run is over, or the process is: what is known of its camera is kept for the next."""
        if self._runs:
            self._memory.over(self._current.core.known, self._current.run)

    def _open_links(self, node: Node, stack: ExitStack) -> None:
        camera, segmenter = self._camera, self._config.segmenter
        ring = max(segmenter.ring, self._config.camera(camera).window + 2) if self._waits else segmenter.ring
        self._committed = KeptSubscriber(node, topics.COMMITTED, Committed, camera=camera)
        self._infos = KeptSubscriber(node, topics.CAMERA_INFO, CameraInfo, camera=camera)
        self._weights = ReliableSubscriber(node, topics.WEIGHT, Weight, camera=camera)
        self._regressors = Presence(node, "regressor", known=known_nodes(self._config))
        self._aggregators = Presence(
            node, "aggregator", known=known_nodes(self._config), on_change=self._aggregator_came.set
        )
        source: Endpoint = node
        if (endpoint := direct_endpoint(self._config.camera(camera), camera)) is not None:
            source = stack.enter_context(DirectLink.open(node, endpoint, link=self._config.link, listens=True))
        self._frames = LatestSubscriber(source, topics.FRAME, Frame, capacity=ring, camera=camera)
        if endpoint is not None and (path := ring_path(endpoint)) is not None:
            self._ring = RingInlet(source, path, self._frames, camera=camera)
        self._progress = KeptPublisher(node, topics.FRAME_PROGRESS, camera=camera)
        self._log_out = ReliablePublisher(node, topics.TRACK, camera=camera)
        self._travel = LatestPublisher(node, topics.TRAVEL, source=camera)
        self._pictures = LatestPublisher(node, topics.PICTURE, camera=camera)
        self._in_view = LatestPublisher(node, topics.IN_VIEW, camera=camera)

    def _open_run(self, run: str) -> None:
        self._remember()
        camera_run = CameraRun(
            self._camera,
            run,
            run_settings(self._config, self._camera),
            log_path(self._config, self._camera, run),
            known=self._memory.known_in(run),
        )
        camera_run.open()
        if camera_run.log.newest:
            self._node.counters.add("log_entries_restored", camera_run.log.newest)
            self._node.log.info("goes on after entry %d of run %s", camera_run.log.newest, run)
        else:
            self._committed.wait(COMMITTED_WAIT_S)
        self._take_commits(camera_run)
        self._belt, self._belt_told, self._oldest_ms, self._unanswered = BeltWatch(), set(), 0.0, 0
        self._node.counters.forget_gauges()
        mark = camera_run.log.last_mark
        self._age, self._clock = FrameAge(self._speed), CameraClock(self._speed, mark.captured_ns if mark else 0)
        self._current = self._runs[run] = camera_run
        self._node.run = run  # reports are of this one from now on

    def _turn(self) -> None:
        """One round: at most one frame, then everything that waits for a turn."""
        busy = self._current.dispatcher.outstanding > 0 or len(self._frames) > 0
        frame = self._frames.get(BUSY_POLL_S if busy else IDLE_POLL_S)
        now_s = time.monotonic()
        if frame is not None:
            self._take_frame(frame, now_s)
        for info in self._infos.latest().values():
            self._take_info(info, now_s)
        while len(self._weights) and (weight := self._weights.get(0.0)) is not None:
            if weight.run in self._runs:
                self._runs[weight.run].weight(weight)
        resend = self._aggregator_came.is_set()
        self._aggregator_came.clear()
        self._current.aggregator_lives = bool(self._aggregators.names())
        for camera_run in list(self._runs.values()):
            if resend:
                camera_run.log.resend()
            self._serve(camera_run, now_s)
        if now_s - self._reported_s >= REPORT_EVERY_S:
            self._reported_s = now_s
            self._leave_gone(self._regressors.names())
            self._report()
            if self._memory.due(now_s):
                self._memory.keep(self._current.core.known, self._current.run, now_s)
        self._tell_finished()

    def _take_frame(self, frame: Frame, now_s: float) -> None:
        counters = self._node.counters
        if frame.run in self._over:
            counters.add("frames_of_older_runs")
            return
        if frame.run not in self._runs:
            self._end_older_runs(now_s)
            self._node.log.info("the camera began run %s", frame.run)
            self._open_run(frame.run)
        camera_run = self._runs[frame.run]
        if camera_run is not self._current:
            counters.add("frames_of_older_runs")
            return
        drop: FrameDrop | None = None
        if not self._waits:
            frame = self._on_time(frame)
            age_ms = self._age.age_ms(frame.captured_ns, time.monotonic_ns())
            self._note_overwritten(camera_run)
            if age_ms > self._config.segmenter.max_age_ms:
                drop = FrameDrop.TOO_OLD
            else:
                self._oldest_ms = max(self._oldest_ms, age_ms)
                counters.gauge("frame_age_ms", age_ms)
                counters.gauge("frame_age_max_ms", self._oldest_ms)
        started_s = time.perf_counter()
        result = camera_run.frame(frame, now_s, drop=drop)
        if result is None:
            return
        counters.gauge("frame_ms", (time.perf_counter() - started_s) * 1000)
        if result.dropped == FrameDrop.CAMERA_CHANGED:
            self._tell_changed(camera_run, frame)
        if result.dropped == FrameDrop.NO_BELT and camera_run.core.belt_hidden:
            self._tell_hidden(camera_run, frame)
        counters.add("instances", result.instances)
        self._watch_belt(camera_run)
        self._tell_unanswered(camera_run.core.unanswered)
        if now_s - self._travel_s >= TRAVEL_EVERY_S and self._travel.has_listener:
            self._travel_s = now_s
            self._travel.put(camera_run.travel(frame.captured_ns))
        if now_s - self._in_view_s >= IN_VIEW_EVERY_S and self._in_view.has_listener:
            self._in_view_s = now_s
            self._in_view.put(tracks_in_view(camera_run, frame.captured_ns))
        if now_s - self._picture_s >= PICTURE_EVERY_S:
            self._picture_s = now_s
            self._show(camera_run, frame, result)

    def _show(self, camera_run: CameraRun, frame: Frame, result: StepResult) -> None:
        """The frame for people, where one of them looks; for no one it costs nothing."""
        if not self._pictures.has_listener:
            return
        started_s = time.perf_counter()
        picture = camera_run.picture(frame, result)
        if picture is not None:
            self._pictures.put(picture)
            self._node.counters.add("pictures_shown")
        self._node.counters.gauge("picture_ms", (time.perf_counter() - started_s) * 1000)

    def _on_time(self, frame: Frame) -> Frame:
        """The frame, its capture time checked for sense."""
        steady_ns, step_ns = self._clock.steady_ns(frame.seq, frame.captured_ns, time.monotonic_ns())
        self._node.counters.gauge("clock_offset_s", self._clock.offset_ns / 1e9)
        if step_ns:
            self._node.counters.add("clock_steps")
            self._node.log.warning(
                "the camera's clock stepped by %+.3f s before frame %d: times go on as if it had not",
                step_ns / 1e9, frame.seq,
            )  # fmt: skip
        return frame if steady_ns == frame.captured_ns else replace(frame, captured_ns=steady_ns)

    def _tell_changed(self, camera_run: CameraRun, frame: Frame) -> None:
        """The first refused frame of a row, and how to go on where all of them are."""
        changed = camera_run.frames.dropped[FrameDrop.CAMERA_CHANGED]
        if is_told(changed):
            self._node.log.error(
                "refused frame %d, the %d. of run %s unlike the first frame, with %s: put the camera back as it was, "
                "or start a new run",
                frame.seq, changed, frame.run, camera_run.core.camera_changed,
            )  # fmt: skip

    def _tell_hidden(self, camera_run: CameraRun, frame: Frame) -> None:
        """What is seen in place of the belt, and that frames are left out until it is seen again."""
        hidden = camera_run.frames.dropped[FrameDrop.NO_BELT]
        if is_told(hidden):
            self._node.log.error(
                "left out frame %d, the %d. of run %s without a belt, until it is seen again: %s",
                frame.seq, hidden, frame.run, camera_run.core.belt_hidden,
            )  # fmt: skip

    def _tell_unanswered(self, tracks: int) -> None:
        """A classifier that says no number."""
        if tracks > self._unanswered and is_told(tracks):
            self._node.log.error(
                "the classifier %s said no number of %d tracks of this run: they count unclassified, clods among them. "
                "Train it again, or leave segmenter.weights out for the shipped one",
                self._config.segmenter.weights, tracks,
            )  # fmt: skip
        self._unanswered = tracks
        self._node.counters.gauge("classifier_no_number", tracks)

    def _watch_belt(self, camera_run: CameraRun) -> None:
        """Levels of the belt, and each finding once in the log."""
        core = camera_run.core
        self._belt.step(core.belt_check, core.instances, travel_m=core.travel_m, told=core.told)
        levels = self._belt.gauges()
        levels |= core.gauge.gauges() | core.gauges()
        if core.noise_px is not None:
            levels["camera_noise_px"] = core.noise_px
        for name, level in levels.items():
            self._node.counters.gauge(name, level)
        found = belt_findings(self._camera, levels)
        for name, finding in found.items():
            if name not in self._belt_told:
                self._belt_told.add(name)
                self._node.log.warning(finding)
        if core.unlike_known and UNLIKE not in self._belt_told:
            self._belt_told.add(UNLIKE)
            self._node.log.info(
                "what was known of the camera is not of this one, %s: what it does to outlines is learned afresh",
                core.unlike_known,
            )
        explained = "belt_alarm" in self._belt_told and "belt_alarm" not in found and levels.get("scaled_by_travel")
        if explained and EXPLAINED not in self._belt_told:
            self._belt_told.add(EXPLAINED)
            self._node.log.info(
                "camera '%s': the belt is where its calibration says; its depth has drifted, which the belt's travel "
                "corrects",
                self._camera,
            )

    def _note_overwritten(self, camera_run: CameraRun) -> None:
        overwritten = self._node.counters.get("frame_dropped_overwritten")
        camera_run.frames.overwritten(overwritten - self._overwritten)
        self._overwritten = overwritten

    def _take_info(self, info: CameraInfo, now_s: float) -> None:
        if info.run in self._runs:
            was_ended = self._runs[info.run].ended
            self._runs[info.run].info(info, now_s)
            if self._runs[info.run].ended and not was_ended:
                self._node.log.info("the camera %s after frame %s", info.state, info.last_seq)

    def _end_older_runs(self, now_s: float) -> None:
        for camera_run in self._runs.values():
            camera_run.end(now_s)

    def _take_commits(self, camera_run: CameraRun) -> None:
        for committed in self._committed.latest().values():
            if committed.run == camera_run.run:
                camera_run.log.commit(committed.n)

    def _serve(self, camera_run: CameraRun, now_s: float) -> None:
        """Send what a run has to send; forget an older run that has nothing left to say."""
        self._take_commits(camera_run)
        machine = None if self._waits else self._processors.busy(now_s)
        for name, view in camera_run.tick(now_s, self._regressors.names(), machine=machine):
            self._work(name).put(view)
        for entry in camera_run.log.due(now_s):
            self._log_out.put(entry)
        if camera_run is self._current:
            progress = camera_run.progress()
            if progress != self._sent_progress or now_s - self._progress_s >= PROGRESS_EVERY_S:
                self._sent_progress, self._progress_s = progress, now_s
                self._progress.put(progress)
        elif camera_run.log.finished:
            camera_run.close()
            del self._runs[camera_run.run]
            self._over.append(camera_run.run)

    def _work(self, regressor: str) -> LatestPublisher:
        if regressor not in self._works:
            self._works[regressor] = LatestPublisher(self._node, topics.VIEW, regressor=regressor)
        return self._works[regressor]

    def _leave_gone(self, regressors: set[str]) -> None:
        """Regressors may come and go for days, each under a name of its own."""
        for name in self._works.keys() - regressors:
            self._works.pop(name).leave()

    def _tell_finished(self) -> None:
        """The aggregator stays until each segmenter has its last acknowledgement: told once, at once."""
        if self._current.log.finished and self._told_finished != self._current.run:
            self._told_finished = self._current.run
            self._report()
            self._node.report_now()

    def _report(self) -> None:
        """Balance sheets as gauges: they are levels of one run, and a new run starts them at zero."""
        camera_run, counters = self._current, self._node.counters
        for sheet, values in camera_run.counts().items():
            for name, value in values.items():
                counters.gauge(f"{sheet}_{name}", value)
        counters.gauge("frames_duplicates", camera_run.frames.duplicates)
        counters.gauge("frames_ahead", camera_run.frames.ahead)
        counters.gauge("views_duplicate_answers", camera_run.dispatcher.duplicates)
        counters.gauge("log_uncommitted", camera_run.log.uncommitted)
        counters.gauge("log_committed", camera_run.log.committed)
        counters.gauge("views_per_tuber", camera_run.budget.views)
        counters.gauge("views_per_tuber_reduced", camera_run.budget.reduced)
        counters.gauge("regressors_busy_share", camera_run.budget.share)
        if (machine_share := camera_run.budget.machine_share) is not None:
            counters.gauge("machine_busy_share", machine_share)
        counters.gauge("tracks_waiting", len(camera_run.weighing))
        if not self._waits and (quickest_ns := self._age.quickest_ns) is not None:
            counters.gauge(AT_START_GAUGE, time.monotonic() - quickest_ns / 1e9 - self._node.uptime_s)
        for reason, n in camera_run.dispatcher.requeued.items():
            counters.gauge(f"views_requeued_{reason}", n)
