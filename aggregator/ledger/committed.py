"""What the aggregator asks its ledger while a run goes on: committed tubers by place, tracks and entries by name."""

from __future__ import annotations

from collections.abc import Sequence

from aggregator.core.committed import CommittedTuber
from aggregator.core.reasons import Role
from aggregator.ledger.reader import entry_checksum, knows_track, read_entry, read_observations, read_tubers_near
from aggregator.ledger.verified import LedgerView


class RunTubers:
    """The ledger of one run, as `aggregator.core.committed.CommittedTubers`."""

    def __init__(self, view: LedgerView, run: str) -> None:
        self._view = view
        self._run = run

    def near(self, low_x_m: float, high_x_m: float) -> Sequence[CommittedTuber]:
        """Committed tubers whose place lies between the two, by id."""
        return [
            CommittedTuber(tuber.tuber_id, tuber.place_x_m, tuber.place_y_m, self._members(tuber.tuber_id))
            for tuber in read_tubers_near(self._view, self._run, low_x_m, high_x_m)
        ]

    def _members(self, tuber_id: int) -> tuple[tuple[str, int, int], ...]:
        seen = read_observations(self._view, self._run, tuber_id=tuber_id)
        return tuple((found[1], found[8], found[9]) for found in seen if found[4] != Role.REPEAT)

    def knows_track(self, track_id: str) -> bool:
        """A track of that id is in the ledger."""
        return knows_track(self._view, self._run, track_id)

    def entry_checksum(self, camera: str, n: int) -> int | None:
        """CRC-32 of an entry as it was received; None where the ledger does not hold it."""
        payload = read_entry(self._view, self._run, camera, n)
        return None if payload is None else entry_checksum(payload)
