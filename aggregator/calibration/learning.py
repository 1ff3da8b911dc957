"""Tubers that were weighed before their camera was known: a ticket of them says little of the loads that follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from conveyor.camera_flags import FLANKS_RAISED, OUTLINE_GROWN, OUTLINE_LOST, SCALED_BY_TRAVEL
from conveyor.messages import Tuber

LEARNED = (OUTLINE_GROWN, OUTLINE_LOST, FLANKS_RAISED, SCALED_BY_TRAVEL)
"""What a line learns of its camera from the tubers that pass, and takes off those that come after."""
LEAST, LEAST_SHARE, MOSTLY = 3, 0.05, 0.5
"""So many tubers before it was known, and so large a share of all, are told; where so many of those after them are
weighed by it."""


@dataclass(frozen=True, slots=True)
class Learning:
    """`before` of `tubers` were weighed before it was known what `flag` says; the first after them is `first_id`."""

    before: int
    tubers: int
    flag: str
    first_id: int

    @property
    def told(self) -> str:
        """In a sentence, with what to do about it."""
        return (
            f"the first {self.before} of these {self.tubers} tubers were weighed before their camera was known, the "
            f"others by what is known of it ({self.flag}): later loads are weighed as the others are. Catch another "
            f"bucket, or weigh those from number {self.first_id} on alone (--first {self.first_id})"
        )


def learning_of(tubers: Sequence[Tuber]) -> Learning | None:
    """Whether the camera was learned while `tubers` crossed, in this order; None where it was known before the first,
    or has nothing to be known.
    """
    found: list[Learning] = []
    for flag in LEARNED:
        told = [flag in tuber.flags for tuber in tubers]
        before = told.index(True) if True in told else 0
        if before >= max(LEAST, LEAST_SHARE * len(tubers)) and sum(told) >= MOSTLY * (len(told) - before):
            found.append(Learning(before, len(tubers), flag, tubers[before].tuber_id))
    return max(found, key=lambda one: one.before, default=None)
