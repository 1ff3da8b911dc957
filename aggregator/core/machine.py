"""The aggregator's state machine: entries in, tubers out, each once.

Values and a clock in, values out. `receive` applies entries in the order of their log, `commit` says what has become
certain since; the caller writes that batch to the ledger and only then acknowledges. Because a tuber becomes certain
when the cameras' marks say so, and its block of the belt is resolved as a whole, the ledger does not depend on the
order in which entries of different cameras arrive, nor on when `commit` is called.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from aggregator.core.camera_log import CameraLog, LoggedEntry, Taken
from aggregator.core.cameras import Cameras
from aggregator.core.committed import CommittedTuber, CommittedTubers
from aggregator.core.foreign import ForeignBody, is_foreign, make_body
from aggregator.core.matching import one_to_one
from aggregator.core.merge import Gate, Group, PlacedTrack, blocks, merge, rejoined
from aggregator.core.reasons import Role
from aggregator.core.sight import CameraSight
from aggregator.core.travel import NOT_KNOWN, TravelKnown
from aggregator.core.tubers import make_tuber
from conveyor.messages import Mark, Track, TrackEntry, Tuber

MAX_PENDING = 100_000
"""Tracks (about 250 MB) that may wait for another camera's marks; beyond it no one is waited for."""


@dataclass(frozen=True, slots=True)
class Observation:
    """Where a track's entry went, and with which tuber."""

    camera: str
    n: int
    track_id: str
    role: Role
    tuber_id: int | None
    place_x_m: float
    place_y_m: float
    first_seq: int
    last_seq: int


@dataclass(frozen=True, slots=True)
class Applied:
    """An entry as applied. A track at `late_from_x_m` or further along came after its place was committed."""

    logged: LoggedEntry
    late_from_x_m: float


@dataclass(frozen=True, slots=True)
class PendingTrack:
    """A track that is in the ledger's entries, but not yet in a tuber."""

    camera: str
    n: int
    track: Track
    late_from_x_m: float


@dataclass(frozen=True, slots=True)
class Batch:
    """Everything that one transaction makes durable.

    `watermark_x_m`: tubers at this place and further along are committed. `settled`: of each camera's log, up to which
    entry every track has gone somewhere. `sights`, `travel`: what is known of the belt.
    """

    entries: tuple[Applied, ...]
    tubers: tuple[Tuber, ...]
    observations: tuple[Observation, ...]
    watermark_x_m: float
    bodies: tuple[ForeignBody, ...] = ()
    settled: Mapping[str, int] = field(default_factory=dict)
    sights: Mapping[str, CameraSight] = field(default_factory=dict)
    travel: TravelKnown = NOT_KNOWN

    @property
    def empty(self) -> bool:
        """Nothing new to write."""
        return not (self.entries or self.tubers or self.observations or self.bodies)


@dataclass(slots=True)
class Restored:
    """A run as the ledger holds it: what `Aggregation` needs to go on."""

    begun: bool = False
    """An earlier process began it."""
    applied: dict[str, int] = field(default_factory=dict)
    marks: dict[str, list[Mark]] = field(default_factory=dict)
    """The last marks of each camera, oldest first."""
    curves: dict[str, list[tuple[int, float, int]]] = field(default_factory=dict)
    sights: dict[str, CameraSight] = field(default_factory=dict)
    pending: list[PendingTrack] = field(default_factory=list)
    tubers: int = 0
    bodies: int = 0
    watermark_x_m: float = math.inf
    travel: TravelKnown = NOT_KNOWN


class Aggregation:
    """One run of one line.

    Args:
        cameras: names of all cameras that are expected.
        committed: what the ledger knows.
        restored: the run's state from the ledger, or None for a new run.
        reach_mm: how far behind a tuber a track of it may still come, by which a live line waits; None: by the whole
            gate, so that what is in the ledger does not depend on when it was looked at.
        count: called with the name of every countable event.
    """

    def __init__(
        self,
        run: str,
        *,
        cameras: Sequence[str],
        merge_gate_mm: float,
        camera_stall_s: float,
        committed: CommittedTubers,
        now_s: float,
        restored: Restored | None = None,
        reach_mm: float | None = None,
        count: Callable[[str], None] = lambda name: None,
    ) -> None:
        state = restored or Restored()
        self.run = run
        self.cameras = Cameras(tuple(cameras), stall_s=camera_stall_s, now_s=now_s)
        self._gate = Gate(merge_gate_mm)
        self._reach_m = self._gate.measured_m if reach_mm is None else min(reach_mm / 1000, self._gate.measured_m)
        self._committed = committed
        self._count = count
        self._logs = {name: CameraLog(state.applied.get(name, 0)) for name in self.cameras.names}
        self._unplaced = list(state.pending)
        self._known = {pending.track.track_id for pending in state.pending}
        self._placed: list[PlacedTrack] = []
        self._entries: list[Applied] = []
        self._observations: list[Observation] = []
        self._tubers = state.tubers
        self._bodies = state.bodies
        self._watermark_x_m = state.watermark_x_m
        if state.begun:
            self.cameras.resumed(state.travel)
            for name in self.cameras.names:
                self.cameras.restored(
                    name,
                    marks=state.marks.get(name, []),
                    curve=state.curves.get(name, []),
                    sight=state.sights.get(name, CameraSight()),
                )

    @property
    def pending(self) -> int:
        """Tracks that wait for marks of other cameras."""
        return len(self._unplaced) + len(self._placed)

    def waiting_m(self) -> dict[str, float]:
        """Belt at the end of each camera's log whose tracks are in no tuber yet, metres."""
        found = dict.fromkeys(self.cameras.names, 0.0)
        if self._placed:
            first_x_m = max(track.place_x_m for track in self._placed)
            found = {camera: self.cameras.beyond_m(camera, first_x_m) for camera in found}
        for pending in self._unplaced:  # its own travel is all that is known of it
            mark = self.cameras.states[pending.camera].mark
            own_m = 0.0 if mark is None else pending.track.place_x_m - mark.complete_place_x_m
            found[pending.camera] = max(found[pending.camera], own_m)
        return found

    @property
    def finished(self) -> bool:
        """Every camera ended and every tuber is committed."""
        return self.cameras.final and not self.pending

    @property
    def waiting(self) -> int:
        """Entries that wait for an earlier one of their log."""
        return sum(len(log.waiting) for log in self._logs.values())

    @property
    def watermark_x_m(self) -> float:
        """Tubers at this place and further along are committed."""
        return self._watermark_x_m

    def applied(self) -> dict[str, int]:
        """How far each camera's log is applied; to be acknowledged once the batch is durable."""
        return {name: log.applied for name, log in self._logs.items()}

    def receive(self, entry: TrackEntry, *, now_s: float) -> Taken:
        """Take one entry as it arrives: in any order, any number of times."""
        taken, ready = self._take(entry)
        if taken is not Taken.APPLIED:
            self._count(taken)
        if taken in (Taken.APPLIED, Taken.WAITING):
            self.cameras.heard(entry.camera, entry, now_s)
        self._apply_all(ready)
        return taken

    def _apply_all(self, ready: Sequence[LoggedEntry]) -> None:
        for logged in ready:
            if not logged.refused:
                self._count(Taken.APPLIED)
            self._apply(logged)

    def set_aside(self, logged: LoggedEntry) -> Taken:
        """Take an entry that could not be read: its number is used up and acknowledged, what it said is lost."""
        entry = logged.entry
        if entry.run != self.run or entry.camera not in self._logs:
            return Taken.OTHER_RUN if entry.run != self.run else Taken.UNKNOWN_CAMERA
        taken, ready = self._logs[entry.camera].put(logged, self._checksum_of(entry.camera))
        if taken not in (Taken.APPLIED, Taken.WAITING):
            self._count(taken)
            return taken
        self._count(Taken.SET_ASIDE)
        self._apply_all(ready)
        return Taken.SET_ASIDE

    def _take(self, entry: TrackEntry) -> tuple[Taken, list[LoggedEntry]]:
        if entry.run != self.run:
            return Taken.OTHER_RUN, []
        if entry.camera not in self._logs:
            return Taken.UNKNOWN_CAMERA, []
        return self._logs[entry.camera].take(entry, self._checksum_of(entry.camera))

    def _checksum_of(self, camera: str) -> Callable[[int], int | None]:
        return lambda n: self._committed.entry_checksum(camera, n)

    def _apply(self, logged: LoggedEntry) -> None:
        entry = logged.entry
        self._entries.append(Applied(logged, self._watermark_x_m))
        if entry.mark is not None:
            self.cameras.marked(entry.camera, entry.mark)
        elif logged.ends:
            self.cameras.ended(entry.camera)
        elif entry.track is not None:
            self.cameras.crossed(entry.camera, entry.track.crossed_x_m)
            self._add_track(PendingTrack(entry.camera, entry.n, entry.track, self._watermark_x_m))

    def _add_track(self, pending: PendingTrack) -> None:
        track = pending.track
        if track.track_id in self._known or self._committed.knows_track(track.track_id):
            self._count("tracks_repeated")
            self._observe(PlacedTrack(pending.camera, pending.n, track, track.place_x_m, track.y_m), Role.REPEAT, None)
        else:
            self._known.add(track.track_id)
            self._unplaced.append(pending)

    def commit(self, *, now_s: float, hold_at_x_m: float = -math.inf) -> Batch:
        """What has become certain: the entries applied since the last call and the tubers that are complete now, but
        none further along than `hold_at_x_m`.
        """
        crowded = self.pending > MAX_PENDING
        if crowded:
            self._count("pending_limit_reached")
        watermark_x_m = self.cameras.watermark_x_m(now_s, wait=not crowded) + self.cameras.place_slack_m
        self._watermark_x_m = min(self._watermark_x_m, max(watermark_x_m, hold_at_x_m))
        self._place()
        tubers, bodies = self._complete_tubers()
        batch = Batch(
            tuple(self._entries),
            tuple(tubers),
            tuple(self._observations),
            self._watermark_x_m,
            tuple(bodies),
            settled=self._settled(),
            sights=self.cameras.sights,
            travel=self.cameras.travel,
        )
        self._entries, self._observations = [], []
        for log in self._logs.values():
            log.fresh.clear()
        return batch

    @property
    def _hurry_m(self) -> float:
        """So much farther behind a committed tuber a track of it may still come."""
        return 0.0 if self.cameras.estimated else self._gate.measured_m - self._reach_m

    def _settled(self) -> dict[str, int]:
        """Up to which entry of its log each camera's tracks have all gone somewhere."""
        settled = self.applied()
        for tracks in (self._unplaced, self._placed):
            for track in tracks:
                if track.n <= settled[track.camera]:
                    settled[track.camera] = track.n - 1
        return settled

    def _place(self) -> None:
        """Give tracks their place on the line's travel; sort out those whose tuber was committed before."""
        placed: list[PlacedTrack] = []
        suspects: list[PlacedTrack] = []
        unplaced, self._unplaced = self._unplaced, []
        for pending in unplaced:
            track = pending.track
            x_m = self.cameras.place_x_m(
                pending.camera,
                track.place_x_m,
                t_ns=track.crossed_ns,
                own_travel_m=track.travel_m,
                estimated=track.travel_estimated,
            )
            if x_m is None:
                self._unplaced.append(pending)
            else:
                from_x_m = pending.late_from_x_m
                seen = PlacedTrack(pending.camera, pending.n, track, x_m, track.y_m, late=x_m >= from_x_m)
                placed.append(seen)
                if x_m >= from_x_m - self._hurry_m:
                    suspects.append(seen)
        duplicates = self._late_duplicates(sorted(suspects, key=lambda track: track.order))
        for seen in placed:
            if seen.late:
                self._count("tracks_late")
            if (tuber_id := duplicates.get(seen.track.track_id)) is not None:
                self._count("tracks_late_duplicate")
                self._observe(seen, Role.LATE_DUPLICATE, tuber_id)
            else:
                self._placed.append(seen)

    def _late_duplicates(self, late: Sequence[PlacedTrack]) -> dict[str, int]:
        """Track id to tuber id for the late tracks whose tuber is committed; one to one for each camera."""
        found: dict[str, int] = {}
        for camera in sorted({track.camera for track in late}):
            groups = rejoined([track for track in late if track.camera == camera], self._gate)
            places = [track.place_x_m for group in groups for track in group.members]
            reach_m = self._gate.widest_m
            tubers = list(self._committed.near(min(places) - reach_m, max(places) + reach_m))
            cost = np.array([[self._late_group_cost(group, tuber) for tuber in tubers] for group in groups])
            for i, j in one_to_one(cost.reshape(len(groups), len(tubers))):
                found.update({track.track.track_id: tubers[j].tuber_id for track in groups[i].members})
        return found

    def _late_group_cost(self, group: Group, tuber: CommittedTuber) -> float:
        costs = [self._late_cost(track, tuber) for track in group.members]
        return math.inf if math.inf in costs else min(costs)

    def _late_cost(self, track: PlacedTrack, tuber: CommittedTuber) -> float:
        seen = track.track
        for camera, first_seq, last_seq in tuber.members:
            if camera == track.camera and seen.first_seq <= last_seq and first_seq <= seen.last_seq:
                return math.inf
        dx_m, dy_m = track.place_x_m - tuber.place_x_m, track.place_y_m - tuber.place_y_m
        return math.hypot(dx_m / self._gate.x_m(seen, seen), dy_m / self._gate.y_m(seen, seen))

    def _complete_tubers(self) -> tuple[list[Tuber], list[ForeignBody]]:
        """Tubers, and what is none, of the blocks that nothing can join any more, in order along the belt."""
        from_x_m = self._watermark_x_m - self._hurry_m
        certain = [track for track in self._placed if track.place_x_m >= from_x_m]
        tubers: list[Tuber] = []
        bodies: list[ForeignBody] = []
        done: set[str] = set()
        reach_m = self._gate.widest_m if self.cameras.estimated else self._reach_m
        for block in blocks(certain, self._gate):
            if min(track.place_x_m for track in block) - reach_m < self._watermark_x_m:
                break
            for group in merge(block, self._gate):
                if is_foreign(group):
                    bodies.append(self._complete_body(group))
                    continue
                self._tubers += 1
                tuber = make_tuber(group, run=self.run, tuber_id=self._tubers)
                tubers.append(tuber)
                self._count("tubers_committed")
                if len(group.members) > 1:
                    self._count("tubers_merged")
                for member in group.members:
                    self._observe(member, Role.COUNTED, tuber.tuber_id)
            done.update(track.track.track_id for track in block)
        self._placed = [track for track in self._placed if track.track.track_id not in done]
        return tubers, bodies

    def _complete_body(self, group: Group) -> ForeignBody:
        self._bodies += 1
        self._count("foreign_committed")
        for member in group.members:
            self._observe(member, Role.FOREIGN, None)
        return make_body(group, run=self.run, body_id=self._bodies)

    def _observe(self, placed: PlacedTrack, role: Role, tuber_id: int | None) -> None:
        track = placed.track
        if role is not Role.REPEAT:
            self._known.discard(track.track_id)
        self._observations.append(
            Observation(
                camera=placed.camera,
                n=placed.n,
                track_id=track.track_id,
                role=role,
                tuber_id=tuber_id,
                place_x_m=placed.place_x_m,
                place_y_m=placed.place_y_m,
                first_seq=track.first_seq,
                last_seq=track.last_seq,
            )
        )
