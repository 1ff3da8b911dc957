"""Tracks that wait for their weights, from closed to ready for the log."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

from conveyor.messages import Track, WeighedView, Weight
from segmenter.dispatch.dispatcher import LostView
from segmenter.results import ClosedTrack


@dataclass(slots=True)
class _Waiting:
    closed: ClosedTrack
    order: int
    deadline_s: float
    answers: dict[str, WeighedView] = field(default_factory=dict)
    losses: Counter[str] = field(default_factory=Counter)
    first_answer_s: float | None = None

    @property
    def view_ids(self) -> set[str]:
        """Of the views that were chosen: what else of it was weighed early is not its business."""
        return {view.view_id for view in self.closed.views}

    @property
    def done(self) -> bool:
        return len(self.answers) + self.losses.total() == len(self.closed.views)


class Weighing:
    """Collects answers and losses per track; a track whose views are all accounted for comes out once.

    Args:
        deadline_s: how long a track waits in all.
        spare_grace_s: how much longer one waits that has an answer; None: until all are there.
    """

    def __init__(self, deadline_s: float, *, spare_grace_s: float | None = None) -> None:
        self._deadline_s = deadline_s
        self._spare_grace_s = spare_grace_s
        self._waiting: dict[str, _Waiting] = {}
        self._touched: set[str] = set()
        self._added = 0

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def tubers(self) -> int:
        """Tubers that wait."""
        return len(self._waiting) - self.foreign

    @property
    def foreign(self) -> int:
        """Clods, stones and haulm that wait for their turn in the log."""
        return sum(waiting.closed.track.kind != "tuber" for waiting in self._waiting.values())

    @property
    def settled(self) -> Counter[str]:
        """Views that are weighed or lost, of tracks that wait for others; by the name they have on a sheet."""
        names: Counter[str] = Counter()
        for waiting in self._waiting.values():
            names["weighed"] += len(waiting.answers)
            names.update({f"lost_{reason}": n for reason, n in waiting.losses.items()})
        return names

    def add(self, closed: ClosedTrack, now_s: float) -> None:
        """Start to wait for the weights of a track."""
        self._waiting[closed.track.track_id] = _Waiting(closed, self._added, now_s + self._deadline_s)
        self._touched.add(closed.track.track_id)
        self._added += 1

    def weighed(self, weight: Weight, now_s: float = 0.0) -> None:
        """Take an answer that can be used."""
        waiting = self._waiting.get(weight.track_id)
        if waiting is None or weight.view_id not in waiting.view_ids:
            return
        if weight.weight_g is None or weight.low_g is None or weight.high_g is None:
            return
        self._touched.add(weight.track_id)
        if waiting.first_answer_s is None:
            waiting.first_answer_s = now_s
        waiting.answers[weight.view_id] = WeighedView(
            view_id=weight.view_id,
            seq=weight.seq,
            weight_g=weight.weight_g,
            low_g=weight.low_g,
            high_g=weight.high_g,
            method=weight.method,
            model=weight.model,
            flags=weight.flags,
            sizes=weight.sizes,
        )

    def lost(self, view: LostView) -> None:
        """Take a loss."""
        waiting = self._waiting.get(view.track_id)
        if waiting is not None and view.view_id in waiting.view_ids:
            self._touched.add(view.track_id)
            waiting.losses[view.reason] += 1

    def overdue(self, now_s: float) -> list[str]:
        """Tracks whose weights have been waited for long enough."""
        return [track_id for track_id, waiting in self._waiting.items() if now_s >= waiting.deadline_s]

    def weighed_enough(self, now_s: float) -> list[str]:
        """Tracks that have an answer and have waited for the others for `spare_grace_s`."""
        if self._spare_grace_s is None:
            return []
        return [
            track_id
            for track_id, waiting in self._waiting.items()
            if waiting.first_answer_s is not None and now_s - waiting.first_answer_s >= self._spare_grace_s
        ]

    def waits_for(self, answer_s: float) -> bool:
        """A view that is sent when its weighed track closes is waited for, if its answer takes `answer_s`."""
        return self._spare_grace_s is None or answer_s <= self._spare_grace_s

    def take_done(self) -> list[Track]:
        """Tracks whose views are all weighed or lost, in the order in which they were closed; each comes out once."""
        if not self._touched:
            return []
        touched, self._touched = self._touched, set()
        done = [track_id for track_id in touched if track_id in self._waiting and self._waiting[track_id].done]
        return [_finished(self._waiting.pop(i)) for i in sorted(done, key=lambda i: self._waiting[i].order)]

    def earliest(self) -> tuple[int, float] | None:
        """(capture time, belt travel) before which no crossing is still waited for; None where none is."""
        tracks = [waiting.closed.track for waiting in self._waiting.values()]
        if not tracks:
            return None
        return min(track.crossed_ns for track in tracks), min(track.travel_m for track in tracks)


def _finished(waiting: _Waiting) -> Track:
    """The track with its answers in the order of the views' ranks."""
    views = tuple(waiting.answers[v.view_id] for v in waiting.closed.views if v.view_id in waiting.answers)
    return replace(
        waiting.closed.track,
        views_sent=len(waiting.closed.views),
        views=views,
        views_lost={str(reason): n for reason, n in sorted(waiting.losses.items())},
    )
