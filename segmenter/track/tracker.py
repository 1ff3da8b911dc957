"""Tracks by place: a tuber's place on the belt is constant while it rides, so it is expected where it was seen last.

Instances and tracks are assigned to one another at the least cost, over the distance to the expected place and the
change of visible area. A track that finds nothing waits at its place: it may be hidden, or taken for a part of its
neighbour. Tracks that are decided go on absorbing what lies at their place until it left the view.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import median

import numpy as np
from numpy.typing import NDArray

from segmenter.frame.belt import BeltGeometry
from segmenter.frame.instances import Instances
from segmenter.track.assignment import least_cost_pairs
from segmenter.track.constants import STEADY_TRUST, SWALLOWED, VACANT_GONE
from segmenter.track.history import TravelHistory
from segmenter.track.track import Hit, State, TrackState
from segmenter.track.views import ViewShelf

NO_MATCH = 1e6
DECIDE_M = 0.075


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """When an instance belongs to a track. Metres.

    Attributes:
        gate_m: how far a tuber may be from its place. More follows rolling tubers, less keeps neighbours apart.
        cut_gate_m: the same where a border cuts it or the track is new.
        area_weight: of the squared change of log area, against the squared distance over the gate.
        decide_m: how far past the centre row a track is closed. More sees more frames, and is later.
        take_turns: where several are due at once and frames come fast, they are classified in one frame after another,
            or a frame would be slow.
        edge_m: from the rims of the view; nearer, a place counts as not seen.
        leave_m: beyond the rims; farther, a track is forgotten.
    """

    gate_m: float = 0.022
    cut_gate_m: float = 0.040
    area_weight: float = 0.5
    decide_m: float = DECIDE_M
    take_turns: bool = False
    edge_m: float = 0.020
    leave_m: float = 0.040


class Tracker:
    """The tracks of one camera. Per frame: `match`, then `update`; `drop_gone` forgets what left the view."""

    def __init__(self, belt: BeltGeometry, settings: TrackSettings, view_offsets_m: tuple[float, ...]) -> None:
        self.belt = belt
        self.settings = settings
        self.tracks: list[TrackState] = []
        self.opened = 0
        self.shifts = 0
        self._view_offsets_m = view_offsets_m
        self._low_m, self._high_m = belt.x_range(0.03)

    def match(self, instances: Instances, travel_m: float) -> list[tuple[int, int]]:
        """Pairs (index of track, index of instance), each used once."""
        if not self.tracks or not len(instances):
            return []
        expected = np.array([[t.place_x_m + travel_m, t.place_y_m] for t in self.tracks])
        areas = np.array([t.area_m2 for t in self.tracks])
        unsure = np.array([t.trust < 0.5 for t in self.tracks])
        ends_cut, cut = np.asarray(instances.cut[:, :2].any(axis=1)), np.asarray(instances.cut.any(axis=1))
        gap = expected[:, None, :] - instances.centre_m[None, :, :]
        distance = np.hypot(gap[..., 0], gap[..., 1])
        loose = ends_cut[None, :] | unsure[:, None]
        gate = np.where(unsure[:, None] | cut[None, :], self.settings.cut_gate_m, self.settings.gate_m)
        growth = np.log(instances.area_m2[None, :] / areas[:, None]) ** 2
        cost = (distance / gate) ** 2 + np.where(loose, 0.0, self.settings.area_weight * growth)
        cost[distance > gate] = NO_MATCH
        return [(i, j) for i, j in least_cost_pairs(cost) if cost[i, j] < NO_MATCH]

    def residual_m(self, pairs: list[tuple[int, int]], instances: Instances, travel_m: float) -> float | None:
        """How much further the belt moved than `travel_m` says, by the well-known tubers in view; None without any."""
        residuals = [
            float(instances.centre_m[j, 0]) - travel_m - self.tracks[i].place_x_m
            for i, j in pairs
            if self.tracks[i].trust >= STEADY_TRUST and not instances.cut[j, :2].any()
            and abs(np.log(instances.area_m2[j] / self.tracks[i].area_m2)) < 0.2
        ]  # fmt: skip
        return median(residuals) if residuals else None

    def update(
        self, seq: int, instances: Instances, pairs: list[tuple[int, int]], travel_m: float,
        *, moved: bool, travel_before_m: float | None,
    ) -> list[tuple[TrackState, int]]:  # fmt: skip
        """Take the matches of a frame and open tracks for the rest; returns (track, index of instance) of all."""
        found: list[tuple[TrackState, int]] = []
        matched = {i for i, _ in pairs}
        taken = {j for _, j in pairs}
        hits = _hits(seq, instances, travel_m)
        for i, j in pairs:
            self.tracks[i].add(hits[j], moved=moved)
            found.append((self.tracks[i], j))
        for i, track in enumerate(self.tracks):
            if i not in matched:
                track.missed += moved
                shown = self._shown_at(track, instances, travel_m)
                track.vacant += moved and shown == 0
                if moved and shown:
                    track.covered += bool(instances.area_m2[shown - 1] > SWALLOWED * track.area_m2)
        for j in range(len(instances)):
            if j not in taken:
                track = self._open(seq, instances, j, travel_m, travel_before_m)
                track.add(hits[j], moved=True)
                self.tracks.append(track)
                found.append((track, j))
        return found

    def shift(self, by_m: float) -> None:
        """The belt had moved `by_m` more than was known: all places lie that much further back. `shifts` counts."""
        self.shifts += 1
        for track in self.tracks:
            track.place_x_m -= by_m
            track.hits = [replace(hit, travel_m=hit.travel_m + by_m) for hit in track.hits]

    def past_row_m(self, track: TrackState, travel_m: float) -> float:
        """How far the track's centre lies past the centre row."""
        x_m = track.place_x_m + travel_m
        return x_m - self.belt.row_crossing_x(track.place_y_m, track.height_m / 2)

    def in_view(self, track: TrackState, travel_m: float) -> bool:
        """The track's place has not left the view, and something may still be seen there."""
        x_m = track.place_x_m + travel_m
        inside = self._low_m - self.settings.leave_m <= x_m <= self._high_m + self.settings.leave_m
        return inside and track.vacant < VACANT_GONE

    def frames_in_view(self, track: TrackState, history: TravelHistory, travel_m: float) -> int:
        """Frames in which the track's place lay well inside the view so far."""
        edge = self.settings.edge_m
        return history.frames_between(
            self._low_m + edge - track.place_x_m, min(travel_m, self._high_m - edge - track.place_x_m)
        )

    def drop_gone(self, travel_m: float) -> None:
        """Forget decided tracks that left the view."""
        self.tracks = [t for t in self.tracks if t.state is State.OPEN or self.in_view(t, travel_m)]

    def _open(
        self, seq: int, instances: Instances, j: int, travel_m: float, travel_before_m: float | None
    ) -> TrackState:
        x_m, y_m = (float(value) for value in instances.centre_m[j])
        height_m = float(instances.height_m[j])
        self.opened += 1
        past_m = x_m - self.belt.row_crossing_x(y_m, height_m / 2)
        jump_m = travel_m - travel_before_m if travel_before_m is not None else np.inf
        return TrackState(
            number=self.opened,
            first_seq=seq,
            countable=past_m - jump_m < self.settings.decide_m,
            place_x_m=x_m - travel_m,
            place_y_m=y_m,
            trust=0.0,
            area_m2=float(instances.area_m2[j]),
            height_m=height_m,
            shelf=ViewShelf(self._view_offsets_m),
        )

    def _shown_at(self, track: TrackState, instances: Instances, travel_m: float) -> int | None:
        """The label at the track's place, 0 where no instance covers it; None where that is not inside the view."""
        x_m = track.place_x_m + travel_m
        if not self._low_m + self.settings.edge_m < x_m < self._high_m - self.settings.edge_m:
            return None
        u, v = self.belt.project(x_m, track.place_y_m, track.height_m / 2)
        return label_at(instances.labels, u, v, instances.stride)


def _hits(seq: int, instances: Instances, travel_m: float) -> list[Hit]:
    """Every instance of a frame as a reading of the tuber that it shows."""
    columns = zip(
        instances.centre_m.tolist(), instances.area_m2.tolist(), instances.volume_m3.tolist(),
        instances.height_m.tolist(), instances.contact.tolist(), instances.cut.tolist(), instances.part.tolist(),
        strict=True,
    )  # fmt: skip
    return [
        Hit(
            seq=seq,
            x_m=x_m,
            y_m=y_m,
            travel_m=travel_m,
            area_m2=area_m2,
            volume_m3=volume_m3,
            height_m=height_m,
            contact=contact,
            whole=not any(cut),
            ends_cut=cut[0] or cut[1],
            part=part,
        )
        for (x_m, y_m), area_m2, volume_m3, height_m, contact, cut, part in columns
    ]


def label_at(labels: NDArray[np.int32], u: float, v: float, stride: int) -> int:
    """The label of the cell of `stride` pixels that pixel (u, v) lies in; 0 beside the image."""
    i, j = math.floor((v + 0.5) / stride), math.floor((u + 0.5) / stride)
    inside = 0 <= i < labels.shape[0] and 0 <= j < labels.shape[1]
    return int(labels[i, j]) if inside else 0
