"""What the aggregation asks of the ledger."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class CommittedTuber:
    """What is needed of a committed tuber to recognise a late track of it: place, and (camera, first, last seq)."""

    tuber_id: int
    place_x_m: float
    place_y_m: float
    members: tuple[tuple[str, int, int], ...]


class CommittedTubers(Protocol):
    """What the ledger knows; asked only about late and repeated tracks."""

    def near(self, low_x_m: float, high_x_m: float) -> Sequence[CommittedTuber]:
        """Committed tubers of this run whose place lies between the two."""
        ...

    def knows_track(self, track_id: str) -> bool:
        """A track of that id is in the ledger."""
        ...

    def entry_checksum(self, camera: str, n: int) -> int | None:
        """CRC-32 of entry n of a camera's log, as it was received; None where the ledger does not hold it."""
        ...
