"""What the numbers of a load are worth: not counting yet, counting, nothing seen (and why), ended."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping

from aggregator.core.coverage import Coverage
from aggregator.core.reasons import LoadState, NothingSeen, why_nothing
from aggregator.core.sight import CameraSight

NO_SPEED_FROM_M = 15.0
"""Belt that may have passed, metres (5 s of the fastest one): so long a belt's speed may take to be seen."""


def load_state(
    sights: Mapping[str, CameraSight],
    coverage: Coverage,
    *,
    count: int,
    over: bool,
    given_up: Collection[str],
    sheets: Mapping[str, Mapping[str, int]],
) -> tuple[LoadState, str]:
    """The state, and the reason for it where one is to be told.

    Args:
        count: tubers committed.
        over: the load ended or was stopped.
        given_up: cameras that are waited for no longer.
        sheets: newest balance sheet of each camera's frames, told by its segmenter beside its log.
    """
    waiting = [name for name, sight in sights.items() if sight.first_ns is None and name not in given_up]
    # Belt looked at that is in no tuber yet was not seen: of it there is no number either.
    saw = bool(coverage.share) or count > 0
    no_speed = str(NothingSeen.NO_SPEED) if coverage.most_m is not None else ""
    if over:
        return (LoadState.ENDED, no_speed) if saw else (LoadState.NOTHING_SEEN, _why(sights, sheets))
    if waiting:
        return LoadState.STARTING, f"no frame processed yet of {', '.join(sorted(waiting))}"
    if all(sight.first_ns is None for sight in sights.values()):
        return LoadState.NOTHING_SEEN, _why(sights, sheets)
    return LoadState.COUNTING, no_speed if (coverage.most_m or 0.0) > NO_SPEED_FROM_M else ""


def _why(sights: Mapping[str, CameraSight], sheets: Mapping[str, Mapping[str, int]]) -> str:
    frames: Counter[str] = Counter()
    for name, sight in sights.items():
        frames.update(sight.frames or sheets.get(name, {}))
    published = sum(sight.published.frames for sight in sights.values())
    return why_nothing(published, frames, moved=any(sight.looked_at_m > 0 for sight in sights.values()))
