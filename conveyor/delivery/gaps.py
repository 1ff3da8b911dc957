"""What a sender sent and did not arrive here: its first messages, and those that Zenoh gave up.

Zenoh's advanced subscriber asks a sender's cache when it is declared and again when the sender's token appears, and has
every later gap repeated. But a live message that arrives before those answers passes for the sender's first, and the
earlier ones that an answer then brings are dropped as old, without a word: so it happens when a sender and its listener
start at the same moment. And of a later gap it asks once: where the link is cut just then, it gives the messages up,
though their sender lives and holds them. Messages are numbered from 0, so each gap can be seen, and is asked for again.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

import zenoh

PATIENCE_S = 30.0
"""Seconds for which a sender that does not answer is asked again: longer than a router takes to come back."""
PAUSE_S = 1.0
"""Seconds between two questions."""
Sender = tuple[zenoh.ZenohId, int]
"""A publisher: its session, and its number there."""


class Gaps:
    """Stands between a subscriber and `deliver`: a sender of which a number is missing is asked for it.

    Its messages wait until it has answered, so that each sender's are delivered in order. Zenoh ends a question that
    reached no one like one whose answer is empty, so the message behind the gap is asked for too: an answer that holds
    it is one. What was sent before the first one heard and is older than the sender's cache is not there to be had and
    is no loss.

    Nothing here calls Zenoh from within one of its callbacks: it delivers what waited while it takes down a link that
    was cut, and a question asked then waits for that to be done, forever.

    Args:
        session: asks the senders' caches.
        deliver: gets every sample, on Zenoh's threads.
        cache: messages a sender keeps.
        lost: gets the number of messages that a sender did not give, because it never answered or no longer had them.
        log: gets a warning when a sender does not answer.
        patience_s: seconds for which it is asked again.
    """

    def __init__(
        self,
        session: zenoh.Session,
        deliver: Callable[[zenoh.Sample], None],
        *,
        cache: int,
        lost: Callable[[int], None],
        log: logging.Logger,
        patience_s: float = PATIENCE_S,
    ) -> None:
        self._session = session
        self._deliver = deliver
        self._cache = cache
        self._lost = lost
        self._log = log
        self._patience_s = patience_s
        self._lock = threading.RLock()  # a cache of this very session answers within the question
        self._next: dict[Sender, int] = {}
        self._waiting: dict[Sender, dict[int, zenoh.Sample]] = {}

    def push(self, sample: zenoh.Sample) -> None:
        """The subscriber's callback."""
        source = sample.source_info
        if source is None:  # a plain put, not numbered
            self._deliver(sample)
            return
        sender, number = (source.source_id.zid, source.source_id.eid), source.source_sn
        with self._lock:
            if sender in self._waiting:
                self._waiting[sender][number] = sample
                return
            expected = self._next.get(sender, 0)
            if number <= expected:
                if number == expected:  # else it came with an answer
                    self._next[sender] = number + 1
                    self._deliver(sample)
                return
            self._waiting[sender] = {number: sample}
        cache = f"{sample.key_expr}/@adv/*/{sender[0]}/{sender[1]}/**"
        self._ask_in(0.0, sender, cache, range(expected, number), time.monotonic() + self._patience_s)

    def _ask_in(self, wait_s: float, sender: Sender, cache: str, gap: range, deadline: float) -> None:
        """Ask on a thread of its own, after a while."""
        asking = threading.Timer(wait_s, self._ask, (sender, cache, gap, deadline))
        asking.daemon = True
        asking.start()

    def _ask(self, sender: Sender, cache: str, gap: range, deadline: float) -> None:
        """Ask the sender's cache for the `gap` and the message behind it; again after a pause if it does not answer."""
        answer: dict[int, zenoh.Sample] = {}

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None and reply.ok.source_info is not None:
                answer[reply.ok.source_info.source_sn] = reply.ok

        def on_end() -> None:
            with self._lock:
                if sender not in self._waiting:  # a session that is closed ends the question that it refused, too
                    return
                waiting = set(self._waiting[sender])
            newest = max(waiting)
            # So many since: the cache has let go of it.
            answered = gap.stop in answer or newest - gap.stop >= self._cache
            if not answered and time.monotonic() < deadline:
                self._log.warning("no answer to the question for messages %d to %d of %s", gap[0], gap[-1], cache)
                self._ask_in(PAUSE_S, sender, cache, gap, deadline)
                return
            missing = len(gap) - sum(number in gap for number in waiting | answer.keys())
            if missing and (gap.start or not answered):
                self._lost(missing)
            self._go_on(sender, cache, gap, answer)

        try:
            self._session.get(
                f"{cache}?_sn={gap.start}..{gap.stop}",
                zenoh.handlers.Callback(on_reply, on_end, indirect=False),
                consolidation=zenoh.ConsolidationMode.NONE,
                accept_replies=zenoh.ReplyKeyExpr.ANY,
            )
        except zenoh.ZError as error:
            self._log.warning("did not ask for messages %d to %d of %s: %s", gap[0], gap[-1], cache, error)
            self._go_on(sender, cache, gap, {})

    def _go_on(self, sender: Sender, cache: str, gap: range, answer: dict[int, zenoh.Sample]) -> None:
        """Deliver what came of the `gap` and what waited for that, in order, up to the next gap."""
        with self._lock:
            found = answer | self._waiting.pop(sender, {})
            expected, waiting = self._next.get(sender, 0), {}
            for number, sample in sorted(found.items()):
                if expected <= number <= max(expected, gap.stop):
                    self._deliver(sample)
                    expected = number + 1
                elif number > expected:
                    waiting[number] = sample
            self._next[sender] = expected
            if waiting:
                self._waiting[sender] = waiting
                again = range(expected, min(waiting))
                self._ask_in(0.0, sender, cache, again, time.monotonic() + self._patience_s)
