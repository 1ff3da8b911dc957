"""Which view goes to which regressor, so that none is lost, none is waited for in vain, and every tuber gets its turn.

Credits bound what a regressor holds; what it holds stands in a table until answered, and goes back into the queue
when it leaves or lets the deadline pass. First views of all tubers go before second views. Pure: time comes in as a
number.

The law, at every moment: sent = weighed + lost + outstanding, where outstanding is queued or held by a regressor.
"""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass, field

from conveyor.messages import View


@dataclass(frozen=True, slots=True)
class DispatchSettings:
    """Seconds. `shed_over`: views waiting beyond which higher ranks are shed; None where the camera waits instead."""

    credits: int = 2
    deadline_s: float = 5.0
    max_attempts: int = 5
    shed_over: int | None = None


@dataclass(frozen=True, slots=True)
class LostView:
    """A view that will not be weighed, and why."""

    view_id: str
    track_id: str
    reason: str


@dataclass(slots=True)
class _Job:
    view: View
    order: int
    attempts: int = 0
    regressor: str | None = None
    deadline_s: float = 0.0


@dataclass(slots=True)
class Dispatcher:
    """The queue, the table of what is outstanding, and the balance."""

    settings: DispatchSettings
    sent: int = 0
    weighed: int = 0
    duplicates: int = 0
    requeued: Counter[str] = field(default_factory=Counter)
    lost: Counter[str] = field(default_factory=Counter)
    _jobs: dict[str, _Job] = field(default_factory=dict)
    _queue: list[tuple[int, int, str]] = field(default_factory=list)
    _held: dict[str, set[str]] = field(default_factory=dict)
    _suspects: set[str] = field(default_factory=set)
    _fresh_losses: list[LostView] = field(default_factory=list)

    @property
    def outstanding(self) -> int:
        """Views neither weighed nor lost."""
        return len(self._jobs)

    @property
    def waiting(self) -> int:
        """Views in the queue, with no regressor."""
        return len(self._jobs) - sum(len(held) for held in self._held.values())

    def regressors(self) -> set[str]:
        """Names of those who take work."""
        return set(self._held)

    def balance(self) -> dict[str, int]:
        """sent = weighed + lost by reason + outstanding."""
        losses = {f"lost_{reason}": n for reason, n in sorted(self.lost.items())}
        return {"sent": self.sent, "weighed": self.weighed, "outstanding": self.outstanding, **losses}

    def offer(self, view: View) -> None:
        """Take a view to be weighed. One that is offered twice counts once."""
        if view.view_id in self._jobs:
            return
        self._jobs[view.view_id] = _Job(view, self.sent)
        heapq.heappush(self._queue, (view.rank, self.sent, view.view_id))
        self.sent += 1
        if self.settings.shed_over is not None:
            self._shed(self.settings.shed_over)

    def present(self, names: set[str]) -> None:
        """Take note of who is alive: newcomers get work, what the missing ones held goes back into the queue."""
        for name in sorted(set(self._held) - names):
            for view_id in sorted(self._held.pop(name)):
                self._give_back(view_id, "regressor_left")
            self._suspects.discard(name)
        for name in sorted(names - set(self._held)):
            self._held[name] = set()

    def assign(self, now_s: float) -> list[tuple[str, View]]:
        """Views to send now, each to the regressor with the fewest in hand. Call after `expire`."""
        sending = []
        while self._queue:
            name = self._freest()
            if name is None:
                break
            _, order, view_id = heapq.heappop(self._queue)
            job = self._jobs.get(view_id)
            if job is None or job.order != order or job.regressor is not None:
                continue
            job.regressor, job.deadline_s = name, now_s + self.settings.deadline_s
            job.attempts += 1
            self._held[name].add(view_id)
            sending.append((name, job.view))
        return sending

    def answer(self, view_id: str, *, regressor: str, usable: bool, reason: str = "") -> bool:
        """Take an answer; False where the view is not waited for (a duplicate, or answered after it was given up)."""
        self._suspects.discard(regressor)
        job = self._jobs.get(view_id)
        if job is None:
            self.duplicates += 1
            return False
        if usable:
            self._forget(job)
            self.weighed += 1
        else:
            self._lose(job, f"refused_{reason}" if reason else "refused")
        return True

    def expire(self, now_s: float) -> None:
        """Take back what was not answered in time. Who missed a deadline gets one view at a time until it answers."""
        for job in [j for j in self._jobs.values() if j.regressor is not None and now_s >= j.deadline_s]:
            name = job.regressor
            if name is not None:
                self._suspects.add(name)
                self._held[name].discard(job.view.view_id)
                self._give_back(job.view.view_id, "deadline")

    def cancel(self, track_id: str, reason: str) -> None:
        """Give up all views of a track."""
        for job in [j for j in self._jobs.values() if j.view.track_id == track_id]:
            self._lose(job, reason)

    def take_losses(self) -> list[LostView]:
        """Views lost since the last call."""
        losses, self._fresh_losses = self._fresh_losses, []
        return losses

    def _freest(self) -> str | None:
        """The regressor to serve next: trusted ones first, the emptiest first; None where nobody has a credit left."""
        free = [
            (name in self._suspects, len(held), name)
            for name, held in self._held.items()
            if len(held) < (1 if name in self._suspects else self.settings.credits)
        ]
        return min(free)[2] if free else None

    def _give_back(self, view_id: str, reason: str) -> None:
        job = self._jobs[view_id]
        job.regressor = None
        self.requeued[reason] += 1
        if job.attempts >= self.settings.max_attempts:
            self._lose(job, "max_attempts")
        else:
            heapq.heappush(self._queue, (job.view.rank, job.order, view_id))

    def _shed(self, limit: int) -> None:
        """Drop the highest ranks, newest first, until the queue is short enough; never a tuber's first view."""
        excess = self.waiting - limit
        if excess <= 0:
            return
        spare = [j for j in self._jobs.values() if j.regressor is None and j.view.rank > 0]
        for job in sorted(spare, key=lambda j: (-j.view.rank, -j.order))[:excess]:
            self._lose(job, "shed")

    def _lose(self, job: _Job, reason: str) -> None:
        self._forget(job)
        self.lost[reason] += 1
        self._fresh_losses.append(LostView(job.view.view_id, job.view.track_id, reason))

    def _forget(self, job: _Job) -> None:
        if job.regressor is not None and job.regressor in self._held:
            self._held[job.regressor].discard(job.view.view_id)
        del self._jobs[job.view.view_id]
