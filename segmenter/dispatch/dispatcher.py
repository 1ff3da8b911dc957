"""Which view goes to which regressor: no view is lost, no lost view is waited for, every tuber gets its turn.

Credits bound what a regressor holds; what it holds stands in a table until answered, and goes back into the queue
when it leaves or lets the deadline pass. On a live line first views of all tubers go before second views. Pure: time
comes in as a number.

A live camera does not wait, and more tubers may come than can be weighed (`shed_over`). Then second and third views
are shed first, and early: those beyond what the regressors, at their measured pace, get done in `spare_wait_s`. One of
them is kept as the fallback view until its tuber's first view is weighed, and takes its place where that one is refused
or lost. Only where the regressors cannot weigh even one view of each tuber, the newest tubers are given up at once
('overload') instead of letting all of them wait for `first_wait_s` and longer.

Where the camera waits (a replay), all views of a tuber are weighed before those of the next: each tuber is complete as
soon as it can be, and the ledger keeps up with the belt. A slow machine must not decide what is weighed: that a
regressor did not answer in time counts as an attempt only where it never answered again and left.

A view that is lost on its way is known with the next answer of its regressor (`InFlight`), and goes to the next one.
On a live line a regressor is given little more time than its answers take; `deadline_s` is the most it gets.

The law, at every moment: sent = weighed + lost + outstanding, where outstanding is queued, kept as a fallback or held
by a regressor.
"""

from __future__ import annotations

import heapq
import math
import sys
from collections import Counter
from dataclasses import dataclass, field

from conveyor.messages import View
from conveyor.reasons import Requeue, ViewLoss
from segmenter.dispatch.in_flight import InFlight
from segmenter.dispatch.throughput import Throughput

FIRSTS_PER_SPARE = 8
"""First views that may wait, whatever the pace, in units of `shed_over`: a bound on memory."""
LEAST_QUEUE = 64
"""Entries below which the queue is left as it is: what was given up meanwhile is skipped when its turn comes."""
TURNS_IN_HAND = 2.0
"""A regressor gets what it weighs in this many of our turns, so that it never waits for us."""


@dataclass(frozen=True, slots=True)
class DispatchSettings:
    """Seconds. `shed_over`: spare views waiting beyond which they are shed; None where the camera waits instead.

    `credits` views are in flight per regressor, up to `most_credits` for one that answers faster than we come round.
    """

    credits: int = 2
    most_credits: int = 16
    deadline_s: float = 5.0
    max_attempts: int = 5
    shed_over: int | None = None
    first_wait_s: float = 30.0
    spare_wait_s: float = 5.0


@dataclass(frozen=True, slots=True)
class LostView:
    """A view that will not be weighed. `reason`: a `ViewLoss`, or 'refused_' and a regressor's (`RefusalWords`)."""

    view_id: str
    track_id: str
    reason: str


@dataclass(slots=True, eq=False)
class _Job:
    view: View
    order: int
    offered_s: float
    attempts: int = 0
    regressor: str | None = None
    deadline_s: float = 0.0
    first: bool = False
    """No view of its tuber is weighed yet, and no better one is on its way."""
    fallback: bool = False
    """Not queued: it takes the first view's place where that one is refused or lost."""

    @property
    def key(self) -> tuple[int, int]:
        """Order of service on a live line, and against the order of shedding."""
        return (0 if self.first else max(1, self.view.rank), self.order)


@dataclass(slots=True, eq=False)
class _Tuber:
    weighed: bool = False
    jobs: list[_Job] = field(default_factory=list)


@dataclass(slots=True)
class Dispatcher:
    """The queue, the table of what is outstanding, and the balance."""

    settings: DispatchSettings
    sent: int = 0
    weighed: int = 0
    duplicates: int = 0
    requeued: Counter[Requeue] = field(default_factory=Counter)
    lost: Counter[str] = field(default_factory=Counter)
    pace: Throughput = field(default_factory=Throughput)
    pressed: bool = False
    """So many tubers wait for their first view that it takes too long, though no spare view is weighed any more."""
    in_flight: InFlight = field(default_factory=InFlight)
    _now_s: float = 0.0
    _jobs: dict[str, _Job] = field(default_factory=dict)
    _tubers: dict[str, _Tuber] = field(default_factory=dict)
    _queue: list[tuple[tuple[int, int], str]] = field(default_factory=list)
    _held: dict[str, set[str]] = field(default_factory=dict)
    _suspects: dict[str, set[str]] = field(default_factory=dict)
    """Regressors that missed a deadline and did not answer since; the view counts as an attempt if they leave."""
    _fresh_losses: list[LostView] = field(default_factory=list)

    @property
    def outstanding(self) -> int:
        """Views neither weighed nor lost."""
        return len(self._jobs)

    @property
    def rate_per_s(self) -> float | None:
        """Views a second that the regressors get done, as measured; None where that is not known (yet, or any more)."""
        return self.pace.total_per_s(name for name in self._held if name not in self._suspects)

    @property
    def backlog_s(self) -> float:
        """How long the regressors, at their measured pace, are at work on what waits and what they hold."""
        rate = self.rate_per_s
        wanted = sum(not job.fallback for job in self._jobs.values())
        return wanted / rate if rate else 0.0

    @property
    def busy(self) -> tuple[int, int]:
        """(regressors with work in hand or standing still, all of them)."""
        return sum(bool(held) or name in self._suspects for name, held in self._held.items()), len(self._held)

    def balance(self) -> dict[str, int]:
        """sent = weighed + lost by reason + outstanding."""
        losses = {f"lost_{reason}": n for reason, n in sorted(self.lost.items())}
        return {"sent": self.sent, "weighed": self.weighed, "outstanding": self.outstanding, **losses}

    def offer(self, view: View, *, now_s: float = 0.0, spare: bool = False, weighed: bool = False) -> None:
        """Take a view to be weighed; a tuber's best one comes first. One that is offered twice counts once.

        `spare`: shed it at once, unless it is the one to be kept as the fallback view. `weighed`: its tuber has an
        answer already.
        """
        if view.view_id in self._jobs:
            return
        tuber = self._tubers.setdefault(view.track_id, _Tuber(weighed=weighed))
        job = _Job(view, self.sent, now_s, first=not tuber.weighed and not tuber.jobs)
        tuber.jobs.append(job)
        self._jobs[view.view_id] = job
        self.sent += 1
        if spare and not job.first:
            self._keep_or_shed(job)
        else:
            self._enqueue(job)

    def present(self, names: set[str]) -> None:
        """Take note of the regressors alive: new ones get work, what missing ones held goes back into the queue."""
        if names == self._held.keys():
            return
        for name in sorted(set(self._held) - names):
            held = self._held.pop(name)
            for view_id in sorted(held):
                self._give_back(self._jobs[view_id], Requeue.REGRESSOR_LEFT)
            for view_id in sorted(self._suspects.pop(name, set()) - held):
                self._blame(view_id)
            self.pace.gone(name)
            self.in_flight.gone(name)
        for name in sorted(names - set(self._held)):
            self._held[name] = set()

    def assign(self, now_s: float) -> list[tuple[str, View]]:
        """Views to send now, each to the regressor with the fewest in hand. Call after `expire`."""
        self._now_s = now_s
        sending = []
        while self._queue:
            name = self._freest()
            if name is None:
                break
            turn, view_id = heapq.heappop(self._queue)
            if not self._waits(turn, view_id):
                continue
            job = self._jobs[view_id]
            job.regressor, job.deadline_s = name, now_s + self._patience_s(name)
            job.attempts += 1
            self.in_flight.sent(name, view_id, now_s)
            self._held[name].add(view_id)
            sending.append((name, job.view))
        return sending

    def answer(self, view_id: str, *, regressor: str, usable: bool, reason: str = "") -> bool:
        """Take an answer; False where the view is not waited for (a duplicate, or answered after it was given up)."""
        self._suspects.pop(regressor, None)
        if regressor in self._held:
            self.pace.answered(regressor)
        for lost_id in self.in_flight.answered(regressor, view_id, self._now_s):
            self._lost_on_the_way(lost_id, regressor)
        job = self._jobs.get(view_id)
        if job is None:
            self.duplicates += 1
            return False
        if not usable:
            self._lose(job, f"{ViewLoss.REFUSED}_{reason}" if reason else ViewLoss.REFUSED)
            return True
        self.weighed += 1
        tuber = self._tubers[job.view.track_id]
        tuber.weighed = True
        self._forget(job)
        for other in [j for j in tuber.jobs if j.fallback]:
            self._lose(other, ViewLoss.SHED)
        return True

    def expire(self, now_s: float) -> None:
        """Take back what was not answered in time, and shed what would not be weighed in time.

        A regressor that missed a deadline gets one view at a time until it answers.
        """
        self._now_s = now_s
        self.pace.step(now_s, [name for name, held in self._held.items() if held and name not in self._suspects])
        for name, held in self._held.items():
            late = [view_id for view_id in held if now_s >= self._jobs[view_id].deadline_s]
            if late:
                self.in_flight.missed(name)
            for view_id in sorted(late):
                job = self._jobs[view_id]
                # What a regressor that is known to stand still does not answer says nothing of the view.
                job.attempts -= self.settings.shed_over is None or name in self._suspects
                blamed = self._suspects.setdefault(name, set())
                if self.settings.shed_over is None and not blamed:
                    blamed.add(view_id)
                held.discard(view_id)
                self._give_back(job, Requeue.DEADLINE)
        if self.settings.shed_over is not None:
            self._shed(now_s, self.settings.shed_over)

    def cancel(self, track_id: str, reason: str) -> None:
        """Give up all views of a track."""
        tuber = self._tubers.get(track_id)
        for job in sorted(tuber.jobs, key=lambda j: -j.view.rank) if tuber else []:
            self._lose(job, reason)

    def give_up(self, view_id: str, reason: str) -> None:
        """Give up one view, if it is still waited for."""
        if job := self._jobs.get(view_id):
            self._lose(job, reason)

    def take_losses(self) -> list[LostView]:
        """Views lost since the last call."""
        losses, self._fresh_losses = self._fresh_losses, []
        return losses

    def _patience_s(self, name: str) -> float:
        """How long a regressor may take for an answer; where the camera waits, a slow one is given its time."""
        if self.settings.shed_over is None:
            return self.settings.deadline_s
        return self.in_flight.patience_s(name, at_most_s=self.settings.deadline_s)

    def _lost_on_the_way(self, view_id: str, name: str) -> None:
        """The regressor has answered what was sent to it after this view."""
        job = self._jobs.get(view_id)
        if job is None or job.regressor != name:
            return
        self._held[name].discard(view_id)
        job.attempts -= self.settings.shed_over is None
        self._give_back(job, Requeue.LOST_ON_THE_WAY)

    def _shed(self, now_s: float, limit: int) -> None:
        """Give up what would wait too long: spare views from the highest rank down and newest first, then tubers."""
        waiting = [job for job in self._jobs.values() if job.regressor is None and not job.fallback]
        spare = sorted((job for job in waiting if not job.first), key=lambda job: job.key)
        excess = len(waiting) - min(limit, self._done_in(self.settings.spare_wait_s))
        kept = len(spare) - max(0, excess)
        for at, job in enumerate(spare):
            if at >= kept or now_s - job.offered_s >= self.settings.spare_wait_s:
                self._keep_or_shed(job)
        firsts = len(waiting) - len(spare)
        self.pressed = firsts > self._done_in(self.settings.spare_wait_s)
        most = min(limit * FIRSTS_PER_SPARE, self._done_in(self.settings.first_wait_s))
        if firsts > most:
            self._give_up(sorted((job for job in waiting if job.first), key=lambda job: job.key)[most:])

    def _keep_or_shed(self, job: _Job) -> None:
        """Shed a spare view, unless its tuber needs it as its fallback view."""
        tuber = self._tubers[job.view.track_id]
        if tuber.weighed or any(not other.first and other.view.rank < job.view.rank for other in tuber.jobs):
            self._lose(job, ViewLoss.SHED)
        else:
            job.fallback = True

    def _give_up(self, firsts: list[_Job]) -> None:
        """Give up tubers that no regressor will weigh in time."""
        for job in firsts:
            tuber = self._tubers[job.view.track_id]
            if not tuber.weighed and all(other.regressor is None for other in tuber.jobs):
                self.cancel(job.view.track_id, ViewLoss.OVERLOAD)

    def _done_in(self, seconds: float) -> int:
        """Views that the regressors get done in that time; any number where their pace is not known."""
        rate = self.rate_per_s
        return sys.maxsize if rate is None else round(rate * seconds)

    def _freest(self) -> str | None:
        """The regressor to serve next: trusted ones first, the emptiest first; None where none has a credit left."""
        free = [
            (name in self._suspects, len(held), name)
            for name, held in self._held.items()
            if len(held) < self._credits(name)
        ]
        return min(free)[2] if free else None

    def _credits(self, name: str) -> int:
        """Views a regressor may hold: what it weighs until we come round again, within bounds."""
        if name in self._suspects:
            return 1
        wanted = math.ceil(TURNS_IN_HAND * (self.pace.rate_per_s(name) or 0.0) * self.pace.turn_s)
        return max(self.settings.credits, min(wanted, self.settings.most_credits))

    def _turn(self, job: _Job) -> tuple[int, int]:
        """Order of service."""
        return (0, job.order) if self.settings.shed_over is None else job.key

    def _enqueue(self, job: _Job) -> None:
        heapq.heappush(self._queue, (self._turn(job), job.view.view_id))
        # Where no regressor comes, or spare views never have their turn, nothing else takes out what was given up.
        if len(self._queue) > 2 * max(LEAST_QUEUE, len(self._jobs)):
            self._queue = sorted({entry for entry in self._queue if self._waits(*entry)})

    def _waits(self, turn: tuple[int, int], view_id: str) -> bool:
        """This entry of the queue is the turn of a view that still waits for it."""
        job = self._jobs.get(view_id)
        return job is not None and self._turn(job) == turn and job.regressor is None and not job.fallback

    def _give_back(self, job: _Job, reason: Requeue) -> None:
        job.regressor = None
        self.requeued[reason] += 1
        if job.attempts >= self.settings.max_attempts:
            self._lose(job, ViewLoss.MAX_ATTEMPTS)
        else:
            self._enqueue(job)

    def _blame(self, view_id: str) -> None:
        """A regressor stood still at this view until its end."""
        if job := self._jobs.get(view_id):
            job.attempts += 1
            if job.attempts >= self.settings.max_attempts:
                self._lose(job, ViewLoss.MAX_ATTEMPTS)

    def _lose(self, job: _Job, reason: str) -> None:
        self.lost[reason] += 1
        self._fresh_losses.append(LostView(job.view.view_id, job.view.track_id, reason))
        self._forget(job)
        tuber = self._tubers.get(job.view.track_id)
        if job.first and tuber is not None and not tuber.weighed:
            self._promote(min(tuber.jobs, key=lambda j: j.view.rank))

    def _promote(self, successor: _Job) -> None:
        """A tuber's first view is lost: its next view takes its place."""
        successor.first, successor.fallback = True, False
        if successor.regressor is None:
            self._enqueue(successor)

    def _forget(self, job: _Job) -> None:
        if job.regressor is not None and job.regressor in self._held:
            self._held[job.regressor].discard(job.view.view_id)
        del self._jobs[job.view.view_id]
        tuber = self._tubers[job.view.track_id]
        tuber.jobs.remove(job)
        if not tuber.jobs:
            del self._tubers[job.view.track_id]
