"""The aggregator's process: track logs in, acknowledgements, tubers and totals out, around the core and the ledger."""

from __future__ import annotations

import math
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

from aggregator.core import matching
from aggregator.core.camera_log import LoggedEntry, Taken, set_aside
from aggregator.core.machine import Batch
from aggregator.ledger.writer import Ledger
from aggregator.opening import core_of, keep_config, open_run
from aggregator.orders import Orders, answer_all
from aggregator.queries import Queries
from aggregator.report import Reporter
from conveyor import __version__, topics
from conveyor.access import known_nodes
from conveyor.camera_clock import AT_START_GAUGE, STANDS_AFTER_S
from conveyor.config import LineConfig
from conveyor.delivery.kept import KeptPublisher, KeptSubscriber
from conveyor.delivery.latest import LatestSubscriber
from conveyor.delivery.presence import Presence
from conveyor.delivery.reliable import ReliablePublisher, ReliableSubscriber
from conveyor.errors import MessageError, Refusal
from conveyor.messages import CameraInfo, Committed, Counters, TrackEntry, Travel
from conveyor.node import Node

BATCH_ENTRIES = 2000
"""A batch is closed early when it holds so many entries: a flood must not make a transaction unbounded."""

TOTALS_EVERY_S = 0.5
TOTALS_SHARE = 10.0
"""Totals take a tenth of the time at most: with many cameras on a busy host, coverage takes longer than entries do."""
LONGEST_GATHER_S = 1.0
COMMITS_APART_S = 0.1
"""From one to the next, at least: cameras mark with each frame, and a commit is two syncs of the disk."""
TRAVELS = 256
COMMITTED_EVERY_S = 1.0
LONGEST_LOOK_S = 0.2
"""An order about a load is not kept waiting longer, whatever the commit interval is."""

GOODBYE_S = 2.0
"""How long the final acknowledgements stay available for a segmenter that does not say it has them."""
LOOK_S = 0.02
ACKNOWLEDGE_AGAIN_S = 0.2
LAST_WORDS_S = 0.3
"""For what was published last (tubers, totals) to reach its listeners."""

COUNTED = (
    *Taken,
    "tubers_committed",
    "tubers_merged",
    "foreign_committed",
    "tracks_late",
    "tracks_late_duplicate",
    "tracks_repeated",
    "batches",
)


class AggregatorNode:
    """One run of a line from its first entry to its summary. Use as a context manager, then `work`."""

    def __init__(self, config: LineConfig, *, run: str, fingerprint: str = "") -> None:
        self._config = config
        self._settings = config.aggregator
        self._run = run
        self._fingerprint = fingerprint
        self._stack = ExitStack()
        self._alive: set[str] = set()
        self._refused_runs: set[str] = set()
        self._told: dict[str, CameraInfo] = {}
        self._committed_s = -math.inf
        self._reported_n = 0

    @property
    def ledger_path(self) -> Path:
        """Where the ledger lies."""
        return self._settings.out / "ledger.db"

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._ledger = stack.enter_context(Ledger(self.ledger_path))
            opened_s = time.monotonic()
            cameras = list(self._config.cameras)
            restored = open_run(
                self._ledger,
                self._run,
                config=self._config,
                cameras=cameras,
                may_be_finished=not self._settings.exit_when_final,
                fingerprint=self._fingerprint,
            )
            self._node = stack.enter_context(
                Node("aggregator", "aggregator", config=self._config, run=self._run, announce=False)
            )
            for name in COUNTED:
                self._node.counters.add(name, 0)
            keep_config(self._config)
            self._core = core_of(
                self._ledger,
                self._run,
                restored,
                config=self._config,
                cameras=cameras,
                now_s=time.monotonic(),
                count=self._node.counters.add,
            )
            if (began_s := self._began_s(opened_s if not restored.begun else None)) is not None:
                self._core.cameras.began(began_s)
            self._reporter = Reporter(self._ledger, self._core, config=self._config, counters=self._node.counters)
            if not self._settings.exit_when_final:
                matching.make_ready()
            self._open_topics()
            self._stack = stack.pop_all()
        self._node.announce()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def _began_s(self, opened_s: float | None) -> float | None:
        """When the run began, by the steady clock: as this process opened it, else by the day's clock; None where that
        cannot say.
        """
        row = self._ledger.run_row(self._run)
        if opened_s is not None or row is None:
            return opened_s
        age_s = (time.time_ns() - row.started_ns) / 1e9
        return time.monotonic() - age_s if 0 <= age_s <= STANDS_AFTER_S else None

    def _open_topics(self) -> None:
        node = self._node
        self._totals_out = KeptPublisher(node, topics.TOTALS)
        self._tubers_out = ReliablePublisher(node, topics.TUBER)
        self._committed_out = {
            camera: KeptPublisher(node, topics.COMMITTED, camera=camera) for camera in self._config.cameras
        }
        self._queries = Queries(node, self.ledger_path, run=self._run, totals=self._reporter.totals(time.monotonic()))
        self._orders = Orders(node, self._ledger, self._core, remark=self._reporter.ticket_remark)
        known = known_nodes(self._config)
        self._segmenters = Presence(node, "segmenter", known=known)
        self._infos = KeptSubscriber(node, topics.CAMERA_INFO, CameraInfo, known=known, camera="*")
        self._reports = KeptSubscriber(node, topics.COUNTERS, Counters, known=known, role="*", name="*")
        self._travels = LatestSubscriber(node, topics.TRAVEL, Travel, capacity=TRAVELS, source="*")
        self._entries = ReliableSubscriber(node, topics.TRACK, TrackEntry, on_refused=self._set_aside, camera="*")
        self._acknowledge()

    def work(self) -> None:
        """Until the run is final and may be left, or the process is told to stop; the summary is written either way.

        Raises:
            LedgerError: the ledger cannot be written; what was not acknowledged is sent again to the next process.
        """
        totals_due_s = committed_due_s = 0.0
        reported, took_s = False, 0.0
        while not self._node.stop.is_set():
            self._gather(self._settings.commit_interval_s, at_most_s=min(took_s, LONGEST_GATHER_S))
            self._node.progress()  # each step by itself: on a starved host one takes seconds
            began_s = time.monotonic()
            self._commit()
            self._node.progress()
            now_s = time.monotonic()
            took_s = now_s - began_s
            answer_all(self._orders, self._commit, now_s)
            if now_s >= committed_due_s:
                self._acknowledge()
                committed_due_s = now_s + COMMITTED_EVERY_S
            if now_s >= totals_due_s:
                self._publish_totals(now_s)
                totals_due_s = now_s + max(TOTALS_EVERY_S, TOTALS_SHARE * (time.monotonic() - now_s))
            self._node.progress()
            if self._core.finished and not reported:
                reported = True
                self._report(now_s)
                if self._settings.exit_when_final:
                    self._leave()
                    return
                self._finish(now_s)
            elif reported and self._reported_n != self._ledger.loads.last_n:
                self._report(now_s)  # a ticket came, or a load was ended or undone, after the belt had ended
        if not reported:
            self._commit()
            self._reporter.stopped()
            now_s = time.monotonic()
            self._ledger.stopped(self._run, self._reporter.at_rest(now_s))
            self._report(now_s, in_haste=True)

    def _gather(self, for_s: float, *, at_most_s: float) -> None:
        """Receive entries until every camera has marked how far it is and the last commit is `COMMITS_APART_S` ago, for
        one commit interval at most; where more wait than that, for `at_most_s`, as long as the last commit took: a slow
        disk must not have little to write.
        """
        deadline_s = time.monotonic() + for_s
        last_s = max(deadline_s, deadline_s - for_s + at_most_s)
        marked: set[str] = set()
        for _ in range(BATCH_ENTRIES):
            now_s = time.monotonic()
            left_s = (last_s if len(self._entries) and not self._orders.waiting else deadline_s) - now_s
            if marked and not len(self._entries) and marked >= self._core.cameras.running:
                left_s = min(left_s, self._committed_s + COMMITS_APART_S - now_s)
            entry = self._entries.get(min(left_s, LONGEST_LOOK_S)) if left_s > 0 else None
            if entry is None:
                if left_s <= LONGEST_LOOK_S or self._orders.waiting:
                    return
                continue
            self._take(entry)
            if entry.mark is not None:
                marked.add(entry.camera)

    def _take(self, entry: TrackEntry) -> None:
        taken = self._core.receive(entry, now_s=time.monotonic())
        if taken is Taken.OTHER_RUN and entry.run not in self._refused_runs and len(self._refused_runs) < 100:
            self._refused_runs.add(entry.run)
            self._node.log.error("refused entries of run %s from %s: this is %s", entry.run, entry.camera, self._run)
        elif taken in (Taken.CONFLICTING, Taken.MALFORMED, Taken.UNKNOWN_CAMERA, Taken.WAITING_FULL):
            self._node.log.error("entry %d of %s: %s", entry.n, entry.camera, taken)

        if taken is Taken.MALFORMED:
            ends = entry.mark is not None and entry.mark.final
            bare = replace(entry, track=None, mark=None)
            self._core.set_aside(LoggedEntry(bare, entry.encode(), refused=str(Refusal.CONTENT), ends=ends))

    def _set_aside(self, key: str, payload: bytes, error: MessageError) -> None:
        """An entry that can never be read must not hold up those behind it, nor come again forever."""
        logged = set_aside(payload, error)
        if logged is None or logged.entry.camera != topics.TRACK.parts(key)["camera"]:
            return
        if self._core.set_aside(logged) is Taken.SET_ASIDE:
            self._node.log.error(
                "entry %d of %s is set aside, %s is lost: %s",
                logged.entry.n,
                logged.entry.camera,
                "the sheet of its end" if logged.ends else "its tuber",
                error,
            )

    def _commit(self) -> None:
        """Make durable what has become certain, then say so."""
        now_s = time.monotonic()
        self._watch_presence(now_s)
        batch = self._core.commit(now_s=now_s, hold_at_x_m=self._orders.hold_at_x_m(now_s))
        if batch.empty:
            return
        self._committed_s = now_s
        self._ledger.write(self._run, batch)
        self._node.counters.add("batches")
        self._tell(batch)
        self._node.counters.gauge("tracks_pending", self._core.pending)
        self._node.counters.gauge("entries_waiting", self._core.waiting)

    def _tell(self, batch: Batch) -> None:
        self._acknowledge()
        for tuber in batch.tubers:
            self._tubers_out.put(tuber)

    def _acknowledge(self) -> None:
        for camera, n in self._core.applied().items():
            self._committed_out[camera].put(Committed(camera=camera, run=self._run, n=n))

    def _watch_presence(self, now_s: float) -> None:
        for info in self._infos.latest().values():
            if info.run == self._run and info is not self._told.get(info.camera):
                self._told[info.camera] = info
                self._core.cameras.info(info, now_s)
        while len(self._travels) and (travel := self._travels.get(0.0)) is not None:
            if travel.run == self._run:
                self._core.cameras.travelled(travel)
        self._reporter.sheets = {report.name: _frames(report) for report in self._sheets()}
        self._watch_clocks()
        self._watch_versions()
        alive = self._segmenters.names()
        for camera in self._core.cameras.names:
            self._core.cameras.presence(camera, alive=camera in alive, now_s=now_s)

    def _sheets(self) -> list[Counters]:
        """The newest reports of this run's segmenters."""
        reports = self._reports.latest().values()
        return [report for report in reports if report.role == "segmenter" and report.run == self._run]

    def _watch_clocks(self) -> None:
        """Cameras on hosts whose clocks differ are laid side by side all the same, and that they differ is told."""
        for arrived_s, report in self._reports.arrivals().values():
            started_s = report.gauges.get(AT_START_GAUGE)
            if started_s is None or report.role != "segmenter" or report.run != self._run:
                continue
            camera_s = started_s + report.uptime_s
            ahead_ns = self._core.cameras.clock(report.name, camera_s, host=report.host, arrived_s=arrived_s)
            if ahead_ns is not None:
                self._node.counters.gauge(f"clock_ahead_s_{report.name}", ahead_ns / 1e9)
                self._node.log.warning(
                    "the clock of camera %s on %s is %+.2f s off that of camera %s: their belts are laid side by side "
                    "by what it is ahead; let one time server set the clocks of all hosts",
                    *(report.name, report.host, ahead_ns / 1e9, self._core.cameras.names[0]),
                )

    def _watch_versions(self) -> None:
        """A node of another version is told once, and stands in the summary."""
        others = self._reporter.other_versions
        for report in self._reports.latest().values():
            name = f"{report.role}/{report.name}"
            if report.version == __version__:
                others.pop(name, None)
            elif others.get(name) != report.version:
                others[name] = report.version
                self._node.log.warning(
                    "%s on %s runs tuberline %s, the ledger is kept by %s: install the same version on every host",
                    *(name, report.host, report.version, __version__),
                )

    def _publish_totals(self, now_s: float) -> None:
        totals = self._reporter.totals(now_s)
        self._totals_out.put(totals)
        self._queries.show(totals)

    def _report(self, now_s: float, *, in_haste: bool = False) -> None:
        """Write summary.json and tubers.csv, and publish the totals as they are now."""
        self._reported_n = self._ledger.loads.last_n
        if not self._reporter.write(self._settings.out, now_s, in_haste=in_haste, turn=self._node.progress):
            self._node.log.warning("stopped early: tubers.csv left out, `tuberline ledger dump` gives every tuber")
        self._publish_totals(now_s)
        self._node.log.info("%s", self._reporter.headline(now_s))

    def _leave(self) -> None:
        """Stay until the segmenters have their last acknowledgement, then mark the run as finished."""
        deadline_s, due_s = time.monotonic() + GOODBYE_S, 0.0
        while (now_s := time.monotonic()) < deadline_s and self._unacknowledged() and not self._node.stop.is_set():
            if now_s >= due_s:
                self._acknowledge()
                due_s = now_s + ACKNOWLEDGE_AGAIN_S
            self._node.stop.wait(LOOK_S)
        self._node.stop.wait(LAST_WORDS_S)
        self._finish(time.monotonic())

    def _unacknowledged(self) -> set[str]:
        """Cameras whose segmenter lives and has not said that it holds the last acknowledgement."""
        applied = self._core.applied()
        told = {
            sheet.name
            for sheet in self._sheets()
            if sheet.gauges.get("log_committed", -1.0) >= applied.get(sheet.name, 0)
        }
        return (set(self._segmenters.names()) & applied.keys()) - told

    def _finish(self, now_s: float) -> None:
        self._ledger.finish(self._run, self._reporter.summary_text(now_s), sights=self._core.cameras.sights)


def _frames(counters: Counters) -> dict[str, int]:
    """The balance sheet of a segmenter's frames."""
    return {
        name.removeprefix("frames_"): int(level)
        for name, level in counters.gauges.items()
        if name.startswith("frames_")
    }


def run_aggregator(config: LineConfig, *, run: str, fingerprint: str = "") -> None:
    """The aggregator's whole life."""
    with AggregatorNode(config, run=run, fingerprint=fingerprint) as node:
        node.work()
