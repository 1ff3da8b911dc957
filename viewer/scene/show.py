"""From one line's messages to entries for the sinks: follows the run, feeds the scenes, counts what it leaves out."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from conveyor.counters import CounterSet
from conveyor.messages import CameraInfo, Frame, Position, Totals, TrackEntry, TracksInView, Travel, Tuber, View
from viewer.scene.belt_scene import BeltScene
from viewer.scene.field_scene import FieldScene, NewCells
from viewer.scene.health_scene import HealthScene
from viewer.scene.inputs import FRAME_RING, Inputs
from viewer.scene.load_scene import LoadScene
from viewer.scene.primitives import Entry, NewRun
from viewer.scene.profiles import Profile

HEALTH_EVERY_S = 1.0
MOST_PER_TURN = 256
"""Messages of one topic handled before the others get their turn: a backlog must not hold up the pictures."""


class OfRun(Protocol):
    """A message that says which run it is of."""

    @property
    def run(self) -> str: ...


class Show:
    """One turn takes what arrived and offers what it makes of it; it never waits.

    Args:
        offer: gives one entry to every sink.
        run: show this run alone; None follows the line from run to run.
        cells: where the field's yield is put, if it is computed on this machine.
    """

    def __init__(
        self,
        inputs: Inputs,
        offer: Callable[[Entry], None],
        *,
        profile: Profile,
        run: str | None,
        counters: CounterSet,
        cells: NewCells | None = None,
    ) -> None:
        self._inputs = inputs
        self._cells = cells or NewCells()
        self._offer = offer
        self._profile = profile
        self._fixed = run is not None
        self._run = run
        self._counters = counters
        self._old_runs: set[str] = set()
        self._waiting_totals: Totals | None = None
        self._health_due = 0.0
        self._open_scenes()
        for name in ("frame", "view", "tuber", "travel", "track", "in_view", "position"):
            counters.add(f"{name}_dropped_other_run", 0)
        for name in (
            "frame_skipped_rate",
            "view_skipped_profile",
            "frame_gaps",
            "frame_shown",
            "view_shown",
            "tuber_shown",
            "position_shown",
            "cells_shown",
        ):
            counters.add(name, 0)

    def turn(self) -> bool:
        """Handle what arrived since the last turn; True when there was anything."""
        busy = self._cameras()
        busy |= self._frames()
        busy |= self._small()
        busy |= self._field_seen()
        busy |= self._views()
        busy |= self._reports()
        return busy

    def _open_scenes(self) -> None:
        self._last_seq: dict[str, int] = {}
        self._belt = BeltScene(self._profile)
        self._load = LoadScene()
        self._health = HealthScene()
        self._field = FieldScene()
        self._say([*self._belt.opening(), *self._load.opening()])

    def _say(self, entries: list[Entry]) -> None:
        for entry in entries:
            self._offer(entry)

    def _of_this_run(self, message: OfRun, topic: str) -> bool:
        if self._run is None:
            self._run = message.run
        if message.run == self._run:
            return True
        self._counters.add(f"{topic}_dropped_other_run")
        return False

    def _cameras(self) -> bool:
        if not self._inputs.infos.wait(0.0):
            return False
        for info in self._inputs.infos.latest().values():
            self._inputs.follow(info.camera)
            self._follow_run(info)
        return True

    def _follow_run(self, info: CameraInfo) -> None:
        """A camera that starts a run never seen before takes the viewer along, into a new recording."""
        if self._fixed or info.run == self._run or info.run in self._old_runs:
            return
        if self._run is not None:
            self._old_runs.add(self._run)
            self._offer(Entry("run", NewRun(info.run), None))
            self._counters.add("runs_followed")
            self._open_scenes()
        self._run = info.run

    def _frames(self) -> bool:
        busy = False
        for inbox in self._inputs.frames.values():
            for _ in range(FRAME_RING):
                frame = inbox.get(0.0)
                if frame is None:
                    break
                busy = True
                self._on_frame(frame)
        return busy

    def _on_frame(self, frame: Frame) -> None:
        if not self._of_this_run(frame, "frame"):
            return
        last = self._last_seq.get(frame.camera)
        if last is not None and frame.seq > last + 1:  # lost on the link, or overwritten in the ring
            self._counters.add("frame_gaps", frame.seq - last - 1)
        self._last_seq[frame.camera] = frame.seq
        entries = self._belt.on_frame(frame)
        drawn = any(entry.heavy for entry in entries)
        self._counters.add("frame_shown" if drawn else "frame_skipped_rate")
        self._say(entries)

    def _views(self) -> bool:
        if self._inputs.views is None:
            return False
        for turn in range(MOST_PER_TURN):
            view: View | None = self._inputs.views.get(0.0)
            if view is None:
                return turn > 0
            if self._of_this_run(view, "view"):
                entries = self._belt.on_view(view)
                self._counters.add("view_shown" if entries else "view_skipped_profile")
                self._say(entries)
        return True

    def _small(self) -> bool:
        """Travel, tracks, what is in view, and tubers."""
        busy = False
        for _ in range(MOST_PER_TURN):
            travel: Travel | None = self._inputs.travel.get(0.0)
            track: TrackEntry | None = self._inputs.tracks.get(0.0)
            in_view: TracksInView | None = self._inputs.in_view.get(0.0)
            tuber: Tuber | None = self._inputs.tubers.get(0.0)
            if travel is None and track is None and in_view is None and tuber is None:
                break
            busy = True
            if travel is not None and self._of_this_run(travel, "travel"):
                self._say(self._belt.on_travel(travel))
            if track is not None and self._of_this_run(track, "track"):
                self._say(self._belt.on_track(track))
            if in_view is not None and self._of_this_run(in_view, "in_view"):
                self._say(self._belt.on_in_view(in_view))
            if tuber is not None and self._of_this_run(tuber, "tuber"):
                self._counters.add("tuber_shown")
                self._say(self._belt.on_tuber(tuber))
                if (counted_until := self._belt.counted_until) is not None:
                    self._say(self._load.on_tuber(tuber, counted_until))
        return busy

    def _field_seen(self) -> bool:
        """The machine's place and the yield: they wait for the first capture time to stand at, and show their view."""
        busy, known = False, self._field.known
        for _ in range(MOST_PER_TURN):
            now = self._belt.newest
            position: Position | None = self._inputs.positions.get(0.0) if now is not None else None
            if position is None or now is None:
                break
            busy = True
            if self._of_this_run(position, "position"):
                self._counters.add("position_shown")
                self._say(self._field.on_position(position, now))
        if self._field.known and not known:
            self._say(self._belt.with_field())
        if self._field.known and self._belt.newest is not None and (found := self._cells.take()) is not None:
            busy = True
            self._counters.add("cells_shown")
            self._say(self._field.on_cells(*found, self._belt.newest))
        return busy

    def _reports(self) -> bool:
        """Totals, and the nodes' health once a second; both wait for the first capture time to stand at."""
        if self._inputs.totals.wait(0.0):
            for totals in self._inputs.totals.latest().values():
                if totals.run == self._run or self._run is None:
                    self._waiting_totals = totals
        now = self._belt.newest
        if now is None:
            return False
        busy = False
        if self._waiting_totals is not None:
            # A replay at full speed is far ahead of its ledger: the total stands where its last tuber crossed.
            moment = now if self._waiting_totals.final else self._belt.counted_until or now
            self._say(self._load.on_totals(self._waiting_totals, moment))
            self._counters.add("totals_shown")
            self._waiting_totals = None
            busy = True
        if time.monotonic() >= self._health_due:
            self._health_due = time.monotonic() + HEALTH_EVERY_S
            reports = self._inputs.counters.latest().values()
            self._say(self._health.update(reports, self._inputs.alive(), now))
        return busy
