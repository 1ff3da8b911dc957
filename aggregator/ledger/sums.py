"""The sums of a run, carried along in every transaction: opening, stopping and totals never add up a million tubers.

They also say how many rows each table has for the run and what their checksums add up to, so that a row that is gone,
there twice, or an older one of itself is found by whatever reads the whole ledger.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

from aggregator.core.foreign import ForeignBody
from aggregator.core.load_sums import LoadSums
from aggregator.core.machine import Batch, Observation
from aggregator.core.reasons import Role
from aggregator.core.sight import CameraSight
from aggregator.ledger.schema import WRITTEN_ONCE, Table
from conveyor.messages import Tuber

DEFAULT_STEP_G = 50.0
_MODULUS = 2**62


@dataclass(slots=True)
class RunSums:
    """What all rows of a run come to.

    Attributes:
        rows: by table, the number of rows and the sum of their checksums.
        tracks: entries that hold a track, by camera. roles: observations by role. repeats: 'repeat's by camera.
        set_aside: entries that could not be read, by camera.
        settled: by camera, up to which entry every track has gone somewhere.
        counted: tubers that tracks were counted for; last_tuber_id: the highest.
        head_start_m, turns: of travel that is estimated (`aggregator.core.travel.TravelKnown`).
        load: sums over the tubers; sights: what each camera looked at.
        stopped: its line was stopped since the last entry came.
        utc_offset_s: of the line's clock when the run began; None in a ledger of a version that did not state it.
        lacks: a repair could not save all of the run.
    """

    load: LoadSums
    rows: dict[str, list[int]] = field(default_factory=lambda: {table.name: [0, 0] for table in WRITTEN_ONCE})
    tracks: dict[str, int] = field(default_factory=dict)
    roles: dict[str, int] = field(default_factory=dict)
    repeats: dict[str, int] = field(default_factory=dict)
    settled: dict[str, int] = field(default_factory=dict)
    set_aside: dict[str, int] = field(default_factory=dict)
    counted: int = 0
    last_tuber_id: int = 0
    last_body_id: int = 0
    head_start_m: float | None = None
    turns: list[tuple[int, float]] = field(default_factory=list)
    sights: dict[str, CameraSight] = field(default_factory=dict)
    stopped: bool = False
    utc_offset_s: int | None = None
    lacks: bool = False

    def add_rows(self, table: Table, rows: Iterable[Sequence[Any]]) -> None:
        """Rows as they are written, their checksum last."""
        sums = self.rows[table.name]
        for row in rows:
            sums[0] += 1
            sums[1] = (sums[1] + row[-1]) % _MODULUS

    def count(self, table: Table) -> int:
        """Rows of the run."""
        return self.rows[table.name][0]

    def add_track(self, camera: str) -> None:
        """An entry that holds a track."""
        self.tracks[camera] = self.tracks.get(camera, 0) + 1

    def add_set_aside(self, camera: str) -> None:
        """An entry that could not be read."""
        self.set_aside[camera] = self.set_aside.get(camera, 0) + 1

    def add_observation(self, camera: str, role: str) -> None:
        """Where a track went."""
        self.roles[role] = self.roles.get(role, 0) + 1
        if role == Role.REPEAT:
            self.repeats[camera] = self.repeats.get(camera, 0) + 1

    def add_tuber(self, tuber: Tuber) -> None:
        """A committed tuber."""
        self.load.add(tuber)
        self.last_tuber_id = max(self.last_tuber_id, tuber.tuber_id)

    def add_body(self, body: ForeignBody) -> None:
        """A clod, a stone or haulm."""
        self.load.add(body)
        self.last_body_id = max(self.last_body_id, body.body_id)

    def add_batch(self, batch: Batch) -> None:
        """Everything of a transaction but the rows' own checksums."""
        for applied in batch.entries:
            if applied.logged.refused:
                self.add_set_aside(applied.logged.entry.camera)
            elif applied.logged.entry.track is not None:
                self.add_track(applied.logged.entry.camera)
        for tuber in batch.tubers:
            self.add_tuber(tuber)
        for body in batch.bodies:
            self.add_body(body)
        for seen in batch.observations:
            self.add_observation(seen.camera, seen.role.value)
        self.counted += _counted(batch.observations)
        self.settled = dict(batch.settled)
        self.head_start_m, self.turns = batch.travel.head_start_m, list(batch.travel.turns)
        self.sights, self.stopped = dict(batch.sights), False

    @property
    def pending(self) -> int:
        """Tracks that are in the logs and not yet in a tuber."""
        return sum(self.tracks.values()) - sum(self.roles.values())

    def text(self) -> str:
        """As the ledger keeps it."""
        added = {name: getattr(self, name) or None for name in ("turns", "stopped", "lacks")}
        added["utc_offset_s"] = self.utc_offset_s
        not_needed = {name for name, value in added.items() if value is None}  # a version before reads it
        left_out = {"load", "sights", *not_needed}
        values = {name: getattr(self, name) for name in self.__slots__ if name not in left_out}
        values["load"] = self.load.plain()
        values["sights"] = {camera: sight.plain() for camera, sight in self.sights.items()}
        return json.dumps(values, sort_keys=True, separators=(",", ":"))

    @classmethod
    def from_text(cls, text: str) -> Self:
        """Back from `text`."""
        values = json.loads(text)
        sights = {camera: CameraSight.from_plain(plain) for camera, plain in values.pop("sights").items()}
        rows = {table.name: [0, 0] for table in WRITTEN_ONCE} | values.pop("rows")  # of version 2: none of loads
        turns = [(t_ns, ahead_m) for t_ns, ahead_m in values.pop("turns", ())]
        return cls(load=LoadSums.from_plain(values.pop("load")), sights=sights, rows=rows, turns=turns, **values)


def _counted(observations: Sequence[Observation]) -> int:
    """Tubers that these observations are the first of: a tuber's tracks are all observed in its own transaction."""
    return len({seen.tuber_id for seen in observations if seen.role is Role.COUNTED})
