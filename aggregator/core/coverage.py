"""How much of a load's belt was really looked at, from its first metre to its last, over all cameras.

Every camera's history (`aggregator.core.sight`) is laid along the line's belt. Belt before its first processed frame,
after the last thing it logged, and while it was away counts as not seen, by the encoder, by another camera, or by the
clock and the last speed. Pure: histories in, shares out.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from aggregator.core.lanes import Stretch, looked_lengths, share_seen
from aggregator.core.reasons import Unseen
from aggregator.core.sight import WHOLE, CameraSight

REPLAY_SLACK_M = 0.5
"""The recordings of one line's cameras start and end a little apart: less than this (or 2 %) behind the others is not
belt missed."""

LIVE_SLACK_M = 0.05
"""Two cameras' knowledge of one belt differs by this, or by `ESTIMATE_DRIFT` of it where travel is estimated."""

ESTIMATE_DRIFT = 0.02
OTHER_CLOCK_NS = 60_000_000_000
"""Cameras that began further apart than this run on different clocks: they are taken to have begun together."""


@dataclass(frozen=True, slots=True)
class Moment:
    """When coverage is asked for.

    Attributes:
        over: the load ended or was stopped: what is not in the logs by now was not seen. While it goes on, cameras that
            are `away` (silent or gone) are measured by the others, and the rest by themselves.
        until_ns: by camera, its capture clock's time until which the belt ran on, where nothing better is known.
        ran_m: by camera, how far the belt ran since its newest mark, where an encoder of its own tells.
        waiting_m: by camera, the belt at the end of its log whose tracks are in no tuber yet. When the load is over
            they are not in its weight: that belt was not seen.
    """

    over: bool
    away: Collection[str] = ()
    until_ns: Mapping[str, int] = field(default_factory=dict)
    ran_m: Mapping[str, float] = field(default_factory=dict)
    waiting_m: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Coverage:
    """What of a load was seen.

    Attributes:
        share: of the line's tubers that passed under a looking camera, 0 to 1; None before the belt moved, and where
            it is not known how far it moved.
        belt_m: from the load's first metre to its last, as far as known.
        cameras: each camera's own share; None before the belt moved.
        unseen_m: by camera and reason, metres.
        most_m: the belt that can have passed at most, where it is not known how far it moved; else None.
    """

    share: float | None
    belt_m: float
    cameras: Mapping[str, float | None]
    unseen_m: Mapping[str, Mapping[Unseen, float]]
    most_m: float | None = None

    def mean_unseen_m(self) -> dict[str, float]:
        """Metres not seen by reason, in the mean of the cameras; reasons that did not happen are left out."""
        found = {reason: sum(own.get(reason, 0.0) for own in self.unseen_m.values()) for reason in Unseen}
        cameras = max(1, len(self.unseen_m))
        return {reason.value: metres / cameras for reason, metres in found.items() if metres > 1e-4}


@dataclass(slots=True)
class _Placed:
    """A camera's belt on the line's axis: `begin` to `end` is what it could know of, and up to `seen` its log tells
    what it looked at. `offset` is where s = 0 lies, or, where the line's travel is not its own, where that is 0."""

    sight: CameraSight
    offset: float
    begin: float = 0.0
    end: float = 0.0
    seen: float = 0.0

    def at(self, s: float) -> float:
        """Where on the axis the camera's belt at `s` lies."""
        return self.offset + (self.sight.laid_m(s) if self.sight.line_m else s)


ALL = (-math.inf, math.inf)


def coverage(
    sights: Mapping[str, CameraSight],
    *,
    seen_by: Mapping[frozenset[str], int],
    moment: Moment,
    window: tuple[float, float] = ALL,
) -> Coverage:
    """What of the run's belt was seen, or of a load's.

    Args:
        sights: all expected cameras.
        seen_by: tubers counted, by the set of cameras that saw them.
        window: from and to which travel, metres (`belt_window`).
    """
    placed = _side_by_side(sights, moment)
    low = min((own.begin for own in placed.values()), default=0.0)
    high = max((own.end for own in placed.values()), default=0.0)
    first, last = max(low, window[0]), min(high, window[1])
    belt_m = last - first
    if belt_m <= WHOLE:
        most_m = None if placed else max((m for s in sights.values() if (m := s.most_m) is not None), default=None)
        return Coverage(None, 0.0, dict.fromkeys(sights), {name: {} for name in sights}, most_m)
    stretches: dict[str, list[Stretch]] = {}
    unseen: dict[str, dict[Unseen, float]] = {}
    for name in sights:
        if name in placed:
            pieces = _own(placed[name], low, high, moment, away=name in moment.away)
        else:
            pieces = [(Stretch(low, high, 0.0), Unseen.NEVER)]
        stretches[name], unseen[name] = _within(pieces, first, last)
    shares = {name: _snapped(sum(s.share * s.length_m for s in own) / belt_m) for name, own in stretches.items()}
    return Coverage(
        share=_snapped(share_seen(looked_lengths(stretches), belt_m=belt_m, shares=shares, seen_by=seen_by)),
        belt_m=belt_m,
        cameras=dict(shares),
        unseen_m={name: {why: m for why, m in own.items() if m > WHOLE} for name, own in unseen.items()},
    )


def _side_by_side(sights: Mapping[str, CameraSight], moment: Moment) -> dict[str, _Placed]:
    """Cameras that looked, on one axis: by their encoder, by the line's travel where it is not their own, or by the
    time at which they began. What one looked at that does not know how far its belt moved lies nowhere on it.
    """
    looked = {name: own for name, own in sights.items() if own.first_ns is not None and own.most_m is None}
    if not looked:
        return {}
    earliest = min(looked, key=lambda name: (looked[name].began_ns or 0, name))
    reference = looked[earliest]
    base = 0.0 if reference.estimated else reference.first_travel_m
    placed = {}
    for name, sight in looked.items():
        offset = sight.first_travel_m
        if sight.line_m:
            offset = -_zero_m(sights)
        elif sight.estimated:
            since_ns = (sight.began_ns or 0) - (reference.began_ns or 0)
            then_ns = (reference.first_ns or 0) + since_ns
            same_clock = since_ns <= OTHER_CLOCK_NS
            offset = base + (reference.s_at(then_ns) - sight.first_s if same_clock and name != earliest else 0.0)
        length = sight.length_m
        running = not moment.over and name not in moment.away
        until_ns = None if sight.final or running else moment.until_ns.get(name)
        end = length if running else sight.end_m(until_ns=until_ns, ran_m=moment.ran_m.get(name))
        seen = length if sight.final or not moment.over else min(length, max(0.0, sight.s_at(sight.complete_ns)))
        if moment.over:
            seen = max(0.0, seen - moment.waiting_m.get(name, 0.0))
        own = placed[name] = _Placed(sight, offset)
        own.begin, own.end, own.seen = own.at(0.0) - sight.missed_before_m(), own.at(end), own.at(seen)
    return placed


def at_rest(sights: Mapping[str, CameraSight], moment: Moment) -> dict[str, CameraSight]:
    """The histories as a ledger keeps them when its line is stopped at `moment`: `coverage` of them, asked for when the
    run is over and with nothing known beside, is the same then.
    """
    return {
        name: sight.at_rest(
            until_ns=moment.until_ns.get(name),
            ran_m=moment.ran_m.get(name),
            waiting_m=moment.waiting_m.get(name, 0.0),
        )
        for name, sight in sights.items()
    }


def belt_window(sights: Mapping[str, CameraSight], from_x_m: float, to_x_m: float) -> tuple[float, float]:
    """The travel at which a stretch of belt between two places (the first the larger) lies at the centre rows of the
    cameras, in the mean of those that have seen a tuber cross it; in the terms of `coverage`.
    """
    rows = [sight.row_x_m for sight in sights.values() if sight.row_x_m is not None]
    row_x_m = sum(rows) / len(rows) if rows else 0.0
    zero_m = _zero_m(sights)
    return row_x_m - from_x_m - zero_m, row_x_m - to_x_m - zero_m


def _zero_m(sights: Mapping[str, CameraSight]) -> float:
    """The line's travel where the axis of `coverage` begins."""
    reference = sights[min(sights)] if sights else CameraSight()
    return reference.first_travel_m if reference.estimated else 0.0


def all_reach(sights: Mapping[str, CameraSight], travel_m: float) -> bool:
    """Every camera's log has come to that travel (in the terms of `coverage`): what it looked at before is known."""
    placed = _side_by_side(sights, Moment(over=False))
    return len(placed) == len(sights) and all(own.at(own.sight.length_m) >= travel_m for own in placed.values())


def _within(
    pieces: Sequence[tuple[Stretch, Unseen | None]], first: float, last: float
) -> tuple[list[Stretch], dict[Unseen, float]]:
    """The stretches from `first` to `last`, and how much of them was missed by reason, metres."""
    stretches, unseen = [], dict.fromkeys((Unseen.BEFORE, Unseen.BETWEEN, Unseen.AFTER), 0.0)
    for stretch, why in pieces:
        inside = Stretch(max(stretch.low, first), min(stretch.high, last), stretch.share)
        if inside.length_m > 0:
            stretches.append(inside)
            if why is not None:
                unseen[why] = unseen.get(why, 0.0) + inside.length_m * (1.0 - inside.share)
    return stretches, unseen


def _own(own: _Placed, low: float, high: float, moment: Moment, *, away: bool) -> list[tuple[Stretch, Unseen | None]]:
    """One camera's stretches from `low` to `high`, and why what it missed of each was missed. Where it began later or
    ended earlier than others by no more than the slack, that belt is left to the others' judgement: it counts as looked
    at.
    """
    slack = _slack(own.sight, high - low)
    before, after = own.begin - low, high - own.end
    late, early = before > slack, after > slack and (moment.over or away)
    pieces: list[tuple[Stretch, Unseen | None]] = [
        (Stretch(low, own.begin, 0.0 if late else 1.0), Unseen.BEFORE),
        (Stretch(own.begin, own.at(0.0), 0.0), Unseen.BEFORE),
    ]
    s, at = 0.0, own.at(0.0)
    for length, looked in own.sight.pieces:
        s += length
        end = min(own.at(s), own.seen)
        if end > at:
            pieces.append((Stretch(at, end, 1.0 if length - looked < WHOLE else looked / length), Unseen.BETWEEN))
        at = max(at, end)
    return [
        *pieces,
        (Stretch(own.seen, own.end, 0.0), Unseen.AFTER),
        (Stretch(own.end, high, 0.0 if early else 1.0), Unseen.AFTER),
    ]


def _snapped(share: float) -> float:
    """All of it is 1, whatever the last digits say."""
    return 1.0 if share > 1.0 - 1e-9 else max(0.0, share)


def _slack(sight: CameraSight, belt_m: float) -> float:
    if sight.published.waits:
        return max(REPLAY_SLACK_M, 0.02 * belt_m)
    return max(LIVE_SLACK_M, ESTIMATE_DRIFT * belt_m if sight.estimated else 0.0)
