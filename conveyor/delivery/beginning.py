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


class Beginnings:
    """Stands between a subscriber and `deliver`: a sender first heard at number n > 0 is asked for what came before.

    Its messages wait until it has answered, so that each sender's are delivered in order. Zenoh ends a question that
    reached nobody like one whose answer is empty, so n itself is asked for too: an answer with n in it is one. What is
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
        self._begun: set[str] = set()
        self._waiting: dict[str, list[zenoh.Sample]] = {}

    def push(self, sample: zenoh.Sample) -> None:
        """The subscriber's callback."""
        if sample.source_info is None:  # a plain put, not numbered
            self._deliver(sample)
            return
        sender = _sender(sample)
        with self._lock:
            if sender in self._waiting:
                self._waiting[sender].append(sample)
                return
            if sender in self._begun or _number(sample) == 0:
                self._begun.add(sender)
                self._deliver(sample)
                return
            self._waiting[sender] = [sample]
        self._ask(sender, _number(sample), time.monotonic() + self._patience_s)

    def _ask(self, sender: str, first: int, deadline: float) -> None:
        """Ask the cache of `sender` for everything up to `first`; again after a pause if it does not answer."""
        answer: dict[int, zenoh.Sample] = {}

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None and reply.ok.source_info is not None:
                answer[_number(reply.ok)] = reply.ok

        def on_end() -> None:
            with self._lock:
                newest = _number(self._waiting[sender][-1])
            answered = first in answer or newest - first >= self._cache  # so many since: the cache has let go of it
            if not answered and time.monotonic() < deadline:
                self._log.warning("no answer to the question for messages 0 to %d of %s", first - 1, sender)
                again = threading.Timer(PAUSE_S, self._ask, (sender, first, deadline))
                again.daemon = True
                again.start()
                return
            if not answered:
                self._lost(first - len(answer))
            self._begin(sender, [answer[n] for n in sorted(answer) if n < first])

        try:
            self._session.get(
                f"{sender}?_sn=0..{first}",
                zenoh.handlers.Callback(on_reply, on_end, indirect=False),
                consolidation=zenoh.ConsolidationMode.NONE,
                accept_replies=zenoh.ReplyKeyExpr.ANY,
            )
        except zenoh.ZError as error:
            self._log.warning("did not ask for messages 0 to %d of %s: %s", first - 1, sender, error)
            self._begin(sender, [])

    def _begin(self, sender: str, earlier: list[zenoh.Sample]) -> None:
        """Deliver `earlier` and what waited for it."""
        with self._lock:
            self._begun.add(sender)
            for sample in (*earlier, *self._waiting.pop(sender)):
                self._deliver(sample)


def _number(sample: zenoh.Sample) -> int:
    """The number its sender gave it, from 0."""
    assert sample.source_info is not None, "an advanced publisher numbers its messages"
    return sample.source_info.source_sn


def _sender(sample: zenoh.Sample) -> str:
    """The publisher of the sample, as the key on which its cache answers."""
    assert sample.source_info is not None
    source = sample.source_info.source_id
    return f"{sample.key_expr}/@adv/*/{source.zid}/{source.eid}/**"
