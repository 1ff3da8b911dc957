"""What a sender sent before the first of its messages that arrived here.

Zenoh's advanced subscriber asks a sender's cache when it is declared and again when the sender's token appears, and has
every later gap repeated. But a live message that arrives before those answers passes for the sender's first, and the
earlier ones that an answer then brings are dropped as old, without a word: so it happens when a sender and its listener
start at the same moment. Messages are numbered from 0, so the hole can be seen, and filled by asking once more.
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


class Beginnings:
    """Stands between a subscriber and `deliver`: a sender first heard at number n > 0 is asked for what came before.

    Its messages wait until it has answered, so that each sender's are delivered in order. Zenoh ends a question that
    reached no one like one whose answer is empty, so n itself is asked for too: an answer with n in it is one. What is
    older than the sender's cache is not there to be had and is no loss.

    Args:
        session: asks the senders' caches.
        deliver: gets every sample, on Zenoh's threads.
        cache: messages a sender keeps.
        lost: gets the number of messages that a sender did not give because it never answered.
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
        self._begun: set[Sender] = set()
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
            if sender in self._begun or number == 0:
                self._begun.add(sender)
                self._deliver(sample)
                return
            self._waiting[sender] = {number: sample}
        cache = f"{sample.key_expr}/@adv/*/{sender[0]}/{sender[1]}/**"
        self._ask(sender, cache, number, time.monotonic() + self._patience_s)

    def _ask(self, sender: Sender, cache: str, first: int, deadline: float) -> None:
        """Ask the sender's cache for everything up to `first`; again after a pause if it does not answer."""
        answer: dict[int, zenoh.Sample] = {}

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None and reply.ok.source_info is not None:
                answer[reply.ok.source_info.source_sn] = reply.ok

        def on_end() -> None:
            with self._lock:
                newest = max(self._waiting[sender])
            answered = first in answer or newest - first >= self._cache  # so many since: the cache has let go of it
            if not answered and time.monotonic() < deadline:
                self._log.warning("no answer to the question for messages 0 to %d of %s", first - 1, cache)
                again = threading.Timer(PAUSE_S, self._ask, (sender, cache, first, deadline))
                again.daemon = True
                again.start()
                return
            if not answered:
                self._lost(first - len(answer))
            self._begin(sender, answer)

        try:
            self._session.get(
                f"{cache}?_sn=0..{first}",
                zenoh.handlers.Callback(on_reply, on_end, indirect=False),
                consolidation=zenoh.ConsolidationMode.NONE,
                accept_replies=zenoh.ReplyKeyExpr.ANY,
            )
        except zenoh.ZError as error:
            self._log.warning("did not ask for messages 0 to %d of %s: %s", first - 1, cache, error)
            self._begin(sender, {})

    def _begin(self, sender: Sender, answer: dict[int, zenoh.Sample]) -> None:
        """Deliver what came of it and what waited for that, in order."""
        with self._lock:
            self._begun.add(sender)
            for _, sample in sorted((answer | self._waiting.pop(sender)).items()):
                self._deliver(sample)
