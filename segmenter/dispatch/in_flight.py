"""What was sent to each regressor, in order: which view never arrived, and how long an answer takes.

A regressor answers in the order in which views arrive, over links that keep their order. So an answer to a view tells
that those sent to it before, and not answered, were lost on the way: known with the next answer instead of after a
deadline. Where nothing comes after the lost one, only time tells: a little more than answers take as a rule, as TCP
does it (RFC 6298), so that a regressor that grew slow is not asked everything twice. Pure: time comes in as a number.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import takewhile

MOST_SENT = 1024
"""Views remembered per regressor; older ones are forgotten, and left to the deadline."""
LEAST_PATIENCE_S = 1.0
"""A busy machine pauses a process for so long now and then: less sends views again that are only late. With 0.5 s and
four times the spread a machine at eight times its load sent one view in nine again."""
SMOOTHING, SPREAD_SMOOTHING = 1 / 8, 1 / 4
SMOOTHED_TIMES, SPREAD_TIMES = 3.0, 8.0
"""Patience in units of the smoothed answer time and of its mean deviation."""


@dataclass(slots=True)
class _Sent:
    when_s: dict[str, float] = field(default_factory=dict)
    """When each view not answered yet was first sent to this regressor, in that order."""
    again: set[str] = field(default_factory=set)
    smoothed_s: float | None = None
    spread_s: float = 0.0
    missed: int = 0


@dataclass(slots=True)
class InFlight:
    """The views on their way to regressors, at them, or on their way back."""

    _by_name: dict[str, _Sent] = field(default_factory=dict)

    def sent(self, name: str, view_id: str, now_s: float) -> None:
        """A view went to a regressor."""
        sent = self._by_name.setdefault(name, _Sent())
        if view_id in sent.when_s:
            sent.again.add(view_id)
            return
        sent.when_s[view_id] = now_s
        if len(sent.when_s) > MOST_SENT:
            oldest = next(iter(sent.when_s))
            del sent.when_s[oldest]
            sent.again.discard(oldest)

    def answered(self, name: str, view_id: str, now_s: float) -> list[str]:
        """An answer came; returns the views sent to that regressor before, and lost on the way.

        The answer to a view that was sent twice tells nothing: it may be the first one's or the second's.
        """
        sent = self._by_name.get(name)
        if sent is None or view_id not in sent.when_s:
            return []
        sent.missed = 0
        before = list(takewhile(lambda other: other != view_id, sent.when_s))
        sent_s = sent.when_s.pop(view_id)
        if view_id in sent.again:
            sent.again.discard(view_id)
            return []
        self._measure(sent, now_s - sent_s)
        lost = [other for other in before if other not in sent.again]
        for other in lost:
            del sent.when_s[other]
        return lost

    def missed(self, name: str) -> None:
        """An answer did not come in time: the next one gets twice as long, until one comes."""
        if name in self._by_name:
            self._by_name[name].missed += 1

    def gone(self, name: str) -> None:
        """The regressor left, and what it held with it."""
        self._by_name.pop(name, None)

    @property
    def usual_s(self) -> float:
        """How long the quickest regressor takes for an answer as a rule; 0 where nothing is known."""
        return min((sent.smoothed_s for sent in self._by_name.values() if sent.smoothed_s is not None), default=0.0)

    def patience_s(self, name: str, *, at_most_s: float) -> float:
        """How long to wait for its next answer; `at_most_s` where nothing is known of it."""
        sent = self._by_name.get(name)
        if sent is None or sent.smoothed_s is None:
            return at_most_s
        usual_s = SMOOTHED_TIMES * sent.smoothed_s + SPREAD_TIMES * sent.spread_s
        return min(max(usual_s, LEAST_PATIENCE_S) * 2.0 ** min(sent.missed, 10), at_most_s)

    @staticmethod
    def _measure(sent: _Sent, took_s: float) -> None:
        if sent.smoothed_s is None:
            sent.smoothed_s, sent.spread_s = took_s, took_s / 2
            return
        sent.spread_s += SPREAD_SMOOTHING * (abs(took_s - sent.smoothed_s) - sent.spread_s)
        sent.smoothed_s += SMOOTHING * (took_s - sent.smoothed_s)
