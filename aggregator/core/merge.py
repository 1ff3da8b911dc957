"""Tracks that lie at one place on the belt are one tuber, whichever camera saw them.

Tracks are first parted into blocks along the belt that cannot touch each other, so a block's outcome depends on nothing
but its own tracks: not on the order of arrival, not on when it was looked at.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from aggregator.core.matching import one_to_one
from conveyor.messages import Track

TRAVEL_SLACK_MM = 10.0
"""Added to the gate along the belt where travel is estimated: two cameras' estimates agree to about that."""

SIZE_COST = 0.02
"""Weight of size against place in the matching: it decides ties and nothing else."""


@dataclass(frozen=True, slots=True)
class PlacedTrack:
    """A track with its place on the common belt; `n` is its entry in the camera's log."""

    camera: str
    n: int
    track: Track
    place_x_m: float
    place_y_m: float
    late: bool = False

    @property
    def order(self) -> tuple[float, float, str, str]:
        """Along the belt, first to pass first; ties by y, camera and id."""
        return (-self.place_x_m, self.place_y_m, self.camera, self.track.track_id)


@dataclass(slots=True)
class Group:
    """Tracks of one tuber."""

    members: list[PlacedTrack] = field(default_factory=list)

    @property
    def place_x_m(self) -> float:
        """Mean place along the belt, each camera counted once."""
        return self._mean([(member.camera, member.place_x_m) for member in self.best])

    @property
    def place_y_m(self) -> float:
        """Mean place across the belt; the lean of two cameras' visible sides cancels in it."""
        return self._mean([(member.camera, member.place_y_m) for member in self.best])

    @property
    def best(self) -> list[PlacedTrack]:
        """The tracks that saw the tuber whole; all where none did."""
        return [member for member in self.members if member.track.whole] or self.members

    @staticmethod
    def _mean(values: list[tuple[str, float]]) -> float:
        cameras = sorted({camera for camera, _ in values})
        per_camera = [[value for name, value in values if name == camera] for camera in cameras]
        return sum(sum(own) / len(own) for own in per_camera) / len(per_camera)


@dataclass(frozen=True, slots=True)
class Gate:
    """How far apart two tracks of one tuber may lie."""

    merge_gate_mm: float

    def x_m(self, a: Track, b: Track) -> float:
        """Along the belt, metres."""
        slack = TRAVEL_SLACK_MM if a.travel_estimated or b.travel_estimated else 0.0
        return (self.merge_gate_mm + slack) / 1000

    def y_m(self, a: Track, b: Track) -> float:
        """Across the belt, metres. Where a side of the image cuts a tuber, the centre of what is left of it lies up to
        half a width off; the other camera, which sees it whole, knows that width."""
        cut_off_mm = 0.0 if a.whole and b.whole else max(a.width_mm, b.width_mm) / 2
        return (self.merge_gate_mm + cut_off_mm) / 1000

    @property
    def widest_m(self) -> float:
        """The farthest that any two tracks of one tuber may lie apart along the belt, metres."""
        return (self.merge_gate_mm + TRAVEL_SLACK_MM) / 1000

    @property
    def measured_m(self) -> float:
        """The same where an encoder tells the travel."""
        return self.merge_gate_mm / 1000


def seen_together(a: Track, b: Track) -> bool:
    """Both were seen in the same frames of a camera, so they are two tubers."""
    return a.first_seq <= b.last_seq and b.first_seq <= a.last_seq


def distance(a: PlacedTrack, b: PlacedTrack, gate: Gate) -> float:
    """How far apart two tracks are as a share of the gate: below 1 they may be one tuber, infinite if they cannot."""
    if a.camera == b.camera and seen_together(a.track, b.track):
        return math.inf
    return math.hypot(
        (a.place_x_m - b.place_x_m) / gate.x_m(a.track, b.track),
        (a.place_y_m - b.place_y_m) / gate.y_m(a.track, b.track),
    )


def blocks(tracks: Sequence[PlacedTrack], gate: Gate) -> list[list[PlacedTrack]]:
    """Tracks parted along the belt into stretches that share no tuber and do not overlap, first to pass first."""
    ordered = sorted(tracks, key=lambda track: track.order)
    lowest = _lowest_linked(ordered, gate)
    parted: list[list[PlacedTrack]] = []
    reach = math.inf
    for track, low_x_m in zip(ordered, lowest, strict=True):
        if not parted or track.place_x_m < reach:
            parted.append([])
        parted[-1].append(track)
        reach = min(reach, low_x_m)
    return parted


def _lowest_linked(ordered: Sequence[PlacedTrack], gate: Gate) -> list[float]:
    """For each track the place of the last track that may be the same tuber; `ordered` descends along the belt."""
    lowest = [track.place_x_m for track in ordered]
    for i, track in enumerate(ordered):
        for other in ordered[i + 1 :]:
            if track.place_x_m - other.place_x_m > gate.widest_m:
                break
            if distance(track, other, gate) < 1.0:
                lowest[i] = other.place_x_m
    return lowest


def merge(block: Sequence[PlacedTrack], gate: Gate) -> list[Group]:
    """The tubers of one block, in order along the belt.

    Camera after camera, by name: its tracks are put together with its own (a camera that restarted), then matched one
    to one with the tubers known so far.
    """
    groups: list[Group] = []
    for camera in sorted({track.camera for track in block}):
        own = sorted((track for track in block if track.camera == camera), key=lambda track: track.order)
        fresh = rejoined(own, gate)
        cost = np.array([[_group_cost(old, new, gate) for new in fresh] for old in groups]).reshape(
            len(groups), len(fresh)
        )
        taken = {j: i for i, j in one_to_one(cost)}
        for j, group in enumerate(fresh):
            if j in taken:
                groups[taken[j]].members.extend(group.members)
            else:
                groups.append(group)
    return sorted(groups, key=lambda group: (-group.place_x_m, group.place_y_m, group.members[0].track.track_id))


def rejoined(own: Sequence[PlacedTrack], gate: Gate) -> list[Group]:
    """One camera's tracks, those of one place that never met in a frame put together, nearest pairs first."""
    groups = [Group([track]) for track in own]
    pairs = sorted((distance(a, b, gate), i, j) for i, a in enumerate(own) for j, b in enumerate(own) if i < j)
    home = list(range(len(own)))
    for apart, i, j in pairs:
        if apart >= 1.0:
            break
        first, second = groups[home[i]], groups[home[j]]
        if first is second or any(seen_together(a.track, b.track) for a in first.members for b in second.members):
            continue
        first.members.extend(second.members)
        second.members = []
        home = [home[i] if at == home[j] else at for at in home]
    return [group for group in groups if group.members]


def _group_cost(old: Group, new: Group, gate: Gate) -> float:
    apart = min(distance(a, b, gate) for a in old.members for b in new.members)
    if apart >= 1.0:
        return math.inf
    return min((1.0 - SIZE_COST) * apart + SIZE_COST * _size_difference(old, new), 0.999999)


def _size_difference(old: Group, new: Group) -> float:
    """0 for equal visible volumes to 1 for a factor of e or more, or where a volume is unknown."""
    a, b = old.members[0].track.visible_volume_ml, new.members[0].track.visible_volume_ml
    return min(1.0, abs(math.log(a / b))) if a > 0 and b > 0 else 1.0
