"""Views that are weighed before their track is decided, so that a live tuber's weight is there when it is counted.

On a live line a track is closed 40 mm past the row (`setup.LIVE_DECIDE_M`); the view on the row, which is the best one,
and the one before it are settled as soon as the tuber has passed. What comes back waits here until the track closes
with its choice of views, which is the same as without: an answer to a view that was not chosen after all is dropped.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from conveyor.messages import View, Weight
from segmenter.dispatch.dispatcher import LostView

FORGOTTEN_AFTER_S = 30.0
"""A track that has not closed by then was refused, or its belt stands still: its views will be weighed again."""


@dataclass(slots=True)
class Early:
    """What became of the views of one track that were sent early."""

    since_s: float
    sent: set[str] = field(default_factory=set)
    answers: dict[str, Weight] = field(default_factory=dict)
    losses: dict[str, LostView] = field(default_factory=dict)


class EarlyViews:
    """By track, until it closes. Pure: time comes in as a number."""

    def __init__(self) -> None:
        self._tracks: dict[str, Early] = {}

    def __len__(self) -> int:
        return len(self._tracks)

    @property
    def settled(self) -> Counter[str]:
        """Views that are weighed or lost, of tracks that are not decided; by the name they have on a sheet."""
        names: Counter[str] = Counter()
        for early in self._tracks.values():
            names["weighed"] += len(early.answers)
            names.update(f"lost_{loss.reason}" for loss in early.losses.values())
        return names

    def sent(self, view: View, now_s: float) -> None:
        """A view went to be weighed."""
        self._tracks.setdefault(view.track_id, Early(now_s)).sent.add(view.view_id)

    def answered(self, weight: Weight) -> bool:
        """Take an answer that can be used; False where its track is not waited for here."""
        early = self._tracks.get(weight.track_id)
        if early is not None:
            early.answers[weight.view_id] = weight
        return early is not None

    def lost(self, loss: LostView) -> bool:
        """Take a loss; False where its track is not waited for here."""
        early = self._tracks.get(loss.track_id)
        if early is not None:
            early.losses[loss.view_id] = loss
        return early is not None

    def closed(self, track_id: str) -> Early:
        """The track is decided and counts: what is known of its views."""
        return self._tracks.pop(track_id, Early(0.0))

    def rest(self) -> list[str]:
        """Nothing closes any more: the views of all tracks that did not."""
        views = sorted(view_id for early in self._tracks.values() for view_id in early.sent)
        self._tracks.clear()
        return views

    def forget_old(self, now_s: float) -> None:
        """Tracks that will not close any more."""
        while self._tracks and now_s - next(iter(self._tracks.values())).since_s > FORGOTTEN_AFTER_S:
            del self._tracks[next(iter(self._tracks))]
