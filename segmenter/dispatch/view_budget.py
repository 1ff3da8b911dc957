"""How many views of each tuber are weighed on a live line: fewer while the regressors have hardly a free moment.

Regressors that are busy all the time make every tuber wait, and on one machine they take the time that looking needs.
The second and third view add little: 3 views of a tuber have most of their errors in common. So where regressors run
beside the cameras a part of the machine stays free of them: what a burst, a viewer or a backup takes is there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from conveyor.processors import Busy

BUSY_SHARE = 0.8
"""Busier than this, one view less; tuned on two cameras on two cores. Lower saves earlier, and weighs less."""
CALM_SHARE = 0.65
"""One view more where that would leave them no busier than this: the distance keeps it from going to and fro."""
BACKLOG_S = 0.04
"""While what waits takes the regressors longer than this, a tuber that comes gets one view: a burst is over before the
share of busy regressors tells of it."""
REMEMBER_S = 1.5
"""What was measured this long ago counts a third."""
SETTLE_S = 3.0
"""After a change the shares are measured again for this long."""
FREE_MARGIN = 0.04
"""One view more where the machine would then have this much more free than it has to."""


@dataclass(slots=True)
class ViewBudget:
    """Views per tuber, between one and `most`. Pure: time comes in as a number."""

    most: int
    free_share: float = 0.0
    """Of the machine's processors, what second and later views leave free; 0 where others than they run elsewhere."""
    views: int = 0
    share: float = 0.0
    """Of the regressors, how many have work in hand, on average."""
    machine_share: float | None = None
    """Of the machine's processors, how much is used, on average; None where it is not known."""
    reduced: int = 0
    """How often the number went down."""
    _now_s: float | None = None
    _changed_s: float = -math.inf

    def __post_init__(self) -> None:
        self.views = self.most

    def now(self, backlog_s: float) -> int:
        """Views of a tuber that comes now, where what waits takes the regressors `backlog_s`."""
        return 1 if backlog_s > BACKLOG_S else self.views

    def step(self, now_s: float, *, busy: int, of: int, machine: Busy | None = None) -> None:
        """Time went on; `busy` of the regressors had work in hand, and `machine` was used as much."""
        elapsed_s = 0.0 if self._now_s is None else max(0.0, now_s - self._now_s)
        self._now_s = now_s
        if of == 0 or elapsed_s == 0.0:
            return
        newer = 1.0 - math.exp(-elapsed_s / REMEMBER_S)
        self.share += newer * (busy / of - self.share)
        if machine is not None:
            before = machine.share if self.machine_share is None else self.machine_share
            self.machine_share = before + newer * (machine.share - before)
        if now_s - self._changed_s < SETTLE_S:
            return
        if self.views > 1 and (self.share > BUSY_SHARE or self._free(0.0) < self.free_share):
            self._change(self.views - 1, now_s)
            self.reduced += 1
        elif self.views < self.most and self.share * (self.views + 1) / self.views < CALM_SHARE:
            another = 0.0 if machine is None else min(1.0, self.share * of / machine.processors) / self.views
            if self._free(another) >= self.free_share + FREE_MARGIN or self.free_share == 0.0:
                self._change(self.views + 1, now_s)

    def _free(self, more: float) -> float:
        """Of the machine's processors, what is free once `more` of them is used."""
        return 1.0 - more - (self.machine_share or 0.0)

    def _change(self, views: int, now_s: float) -> None:
        self.views, self._changed_s = views, now_s
