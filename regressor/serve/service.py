"""What a regressor does about its weights while it weighs: answers who asks, takes new ones, follows the others.

Loading, checking and changing over happen between two views, in the thread that weighs; a view is weighed by one set of
weights, and none waits longer than a check takes. Of all orders that any regressor of the line follows the highest
holds: who joins, or comes back from a cut link, asks the others and takes over what they weigh with.
"""

from __future__ import annotations

import queue
import re
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import zenoh

from conveyor.errors import InputError, StorageError, TuberlineError
from conveyor.messages.base import Message
from conveyor.node import Node
from conveyor.topics import ORDER_MODEL, QUERY_MODEL, Topic
from regressor.network.stored import SHIPPED
from regressor.serve.check import answers_of, check_weights
from regressor.serve.form import form_of
from regressor.serve.link import PIECE_BYTES, fetch, states
from regressor.serve.messages import CloudAnswer, WeightsReport, WeightsState, digest_of, read_parcel
from regressor.serve.store import Order, WeightsStore
from regressor.serve.upload import Upload
from regressor.weigh.weigher import Weigher

FOLLOW_EVERY_S = 10.0
LARGEST_ORDER = 2**53
_DIGEST = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class _Tried:
    """Weights that passed their check and can take over at once."""

    digest: str
    weigher: Weigher
    answers: tuple[CloudAnswer, ...]


class WeightsService:
    """The weights of one regressor. `turn` belongs into the loop that weighs; all else runs on threads of its own."""

    def __init__(self, node: Node, weigher: Weigher) -> None:
        settings = node.config.regressor
        self._node = node
        self._own_parcel = read_parcel(settings.weights or SHIPPED)
        self._config_digest = digest_of(self._own_parcel)
        self._store = WeightsStore(settings.state_dir / node.name if settings.state_dir else None)
        self._order = Order(0, self._config_digest, config_digest=self._config_digest)
        self._weigher = self._config_weigher = weigher
        self._refused: tuple[Order, str] | None = None
        self._tried: _Tried | None = None
        self._upload = Upload()
        self._closing = threading.Event()
        self._follower: threading.Thread | None = None
        self._waiting: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        for counter in ("weights_changed", "weights_refused"):
            node.counters.add(counter, 0)

    def open(self) -> Weigher:
        """Take up what was followed before, or what the others follow; then answer. The weights to begin with."""
        self._restore()
        self._queryables = [
            self._declare(QUERY_MODEL, {"state": self._tell, "piece": self._give_piece}),
            self._declare(ORDER_MODEL, {"piece": self._take_piece, "check": self._later, "take": self._later}),
        ]
        self._look_round()
        self._follower = threading.Thread(target=self._follow, name="weights", daemon=True)
        self._follower.start()
        return self.turn()

    def close(self) -> None:
        """Follow no one any more, and forget what was only for this process."""
        self._closing.set()
        if self._follower is not None:
            self._follower.join()
        self._store.close()

    def turn(self) -> Weigher:
        """Do what waits for a moment between two views; the weights to go on with."""
        while not self._waiting.empty():
            self._waiting.get()()
        return self._weigher

    @property
    def state(self) -> WeightsState:
        """Which weights these are."""
        return WeightsState(
            regressor=self._node.name,
            host=socket.gethostname(),
            n=self._order.n,
            digest=self._order.digest,
            model=self._weigher.sidecar.model_id,
            previous_digest=self._order.previous,
            previous_model=self._order.previous_model,
            refused=self._refused[1][:4000] if self._refused else "",
        )

    def _restore(self) -> None:
        """Go on with the order that was followed before a restart.

        Raises:
            StorageError: there is no room to unpack those weights now: weighing with others would be no better.
        """
        try:
            order = self._store.recorded(config_digest=self._config_digest)
            if order is not None:
                self._weigher = self._weigher_of(order.digest)
                self._order = order
                self._node.log.info("goes on with %s by order %d", self._weigher.sidecar.model_id, order.n)
        except StorageError:
            raise
        except TuberlineError as error:
            self._node.counters.add("weights_refused")
            self._node.log.error("goes on with the config's weights: %s", error)

    def _follow(self) -> None:
        while not self._closing.wait(FOLLOW_EVERY_S):
            self._look_round()

    def _look_round(self) -> None:
        """Fetch what the highest order of the line says, if it is not followed here; it takes over in `turn`."""
        node = self._node
        try:
            others = [s for s in states(node.session, node.line).values() if s.regressor != node.name and s.n > 0]
            if not others:
                return
            newest = max(others, key=lambda state: (state.n, state.digest))
            order = self._next(newest.n, newest.digest)
            if not order.newer_than(self._order) or (self._refused and self._refused[0] == order):
                return
            if not self._has(order.digest):
                self._store.add(fetch(node.session, node.line, newest, order.digest))
            self._waiting.put(lambda: self._follow_order(order, newest.regressor))
        except TuberlineError as error:
            node.log.warning("cannot follow the weights of the others now: %s", error)
        except zenoh.ZError as error:  # the link goes down while asking
            node.log.warning("cannot ask the others for their weights: %s", error)

    def _follow_order(self, order: Order, leader: str) -> None:
        if not order.newer_than(self._order):
            return
        try:
            self._change(order)
        except StorageError as error:  # it may pass: the next look round tries again
            self._node.log.warning("cannot follow order %d of %s now: %s", order.n, leader, error)
        except TuberlineError as error:
            self._refuse(order, f"order {order.n} of {leader}: {error}")

    def _refuse(self, order: Order, why: str) -> None:
        self._refused = order, why
        self._node.counters.add("weights_refused")
        self._node.log.error("goes on with %s: %s", self._weigher.sidecar.model_id, why)

    def _declare(self, topic: Topic, handlers: dict[str, Callable[[zenoh.Query], bytes | None]]) -> Any:
        key = topic.key(self._node.line, regressor=self._node.name)

        def handle(query: zenoh.Query) -> None:
            self._answer(query, key, lambda: _handler(handlers, query)(query))

        return self._node.session.declare_queryable(key, zenoh.handlers.Callback(handle, indirect=True))

    def _answer(self, query: zenoh.Query, key: str, work: Callable[[], bytes | None]) -> None:
        """Reply with what `work` gives, or with its error; a query whose work is put off stays open."""
        try:
            reply = work()
            if reply is None:
                return
            query.reply(key, reply)
        except TuberlineError as error:
            self._refuse_query(query, str(error))
        except zenoh.ZError as error:  # the link went down meanwhile; who asked asks again
            self._node.log.warning("cannot answer on %s: %s", key, error)
        query.drop()  # type: ignore[no-untyped-call, unused-ignore]

    def _refuse_query(self, query: zenoh.Query, why: str) -> None:
        try:
            query.reply_err(why)
        except zenoh.ZError as error:
            self._node.log.warning("cannot answer '%s': %s", why, error)

    def _tell(self, _query: zenoh.Query) -> bytes:
        return self.state.encode()

    def _give_piece(self, query: zenoh.Query) -> bytes:
        digest, offset = _digest(query), _whole(query, "offset")
        return self._parcel(digest)[offset : offset + PIECE_BYTES]

    def _take_piece(self, query: zenoh.Query) -> bytes:
        digest, offset, size = _digest(query), _whole(query, "offset"), _whole(query, "size")
        if self._has(digest):
            return str(size).encode()
        piece = query.payload.to_bytes() if query.payload is not None else b""
        have, parcel = self._upload.take(digest, offset=offset, size=size, piece=piece)
        if parcel is not None:
            self._store.keep_only({self._order.digest, self._order.previous})
            self._store.add(parcel)
        return str(have).encode()

    def _later(self, query: zenoh.Query) -> None:
        digest, key = _digest(query), ORDER_MODEL.key(self._node.line, regressor=self._node.name)
        work: Callable[[], Message]
        if query.parameters.get("do") == "check":
            work = lambda: self._checked(digest)  # noqa: E731
        else:
            n = _whole(query, "n")
            work = lambda: self._taken(n, digest)  # noqa: E731
        self._waiting.put(lambda: self._answer(query, key, lambda: work().encode()))

    def _checked(self, digest: str) -> WeightsReport:
        try:
            tried = self._try(digest)
        except TuberlineError:
            self._node.counters.add("weights_refused")
            raise
        now = self._weigher
        return WeightsReport(
            regressor=self._node.name,
            model=tried.weigher.sidecar.model_id,
            now_model=now.sidecar.model_id,
            answers=tried.answers,
            now_answers=answers_of(now),
        )

    def _taken(self, n: int, digest: str) -> WeightsState:
        order = self._next(n, digest)
        if (n, digest) == (self._order.n, self._order.digest):
            return self.state  # asked twice
        if not order.newer_than(self._order):
            raise InputError(f"regressor {self._node.name} follows order {self._order.n} already: {n} is not newer")
        self._change(order)
        return self.state

    def _next(self, n: int, digest: str) -> Order:
        """The order that would come after the one followed now; for the same weights, what was before them stays."""
        if digest == self._order.digest:
            return replace(self._order, n=n)
        model = self._weigher.sidecar.model_id
        return replace(self._order, n=n, digest=digest, previous=self._order.digest, previous_model=model)

    def _change(self, order: Order) -> None:
        """Weigh with the weights of `order` from the next view on, and after a restart too."""
        tried = self._try(order.digest)
        self._store.add(self._own_parcel)
        self._store.record(order)
        self._order, self._weigher = order, tried.weigher
        self._refused = self._tried = None
        self._node.counters.add("weights_changed")
        self._node.log.info("weighs with %s by order %d", tried.weigher.sidecar.model_id, order.n)

    def _try(self, digest: str) -> _Tried:
        if self._tried is None or self._tried.digest != digest:
            weigher = self._weigher_of(digest)
            proven = digest in (self._config_digest, self._order.digest, self._order.previous)
            # The way back is always open: what has weighed here needs no proof.
            answers = answers_of(weigher) if proven else check_weights(weigher, self._node.config)
            self._tried = _Tried(digest, weigher, answers)
        return self._tried

    def _has(self, digest: str) -> bool:
        return digest == self._config_digest or self._store.has(digest)

    def _parcel(self, digest: str) -> bytes:
        return self._own_parcel if digest == self._config_digest else self._store.parcel(digest)

    def _weigher_of(self, digest: str) -> Weigher:
        if digest == self._config_digest:
            return self._config_weigher
        weigher, device = self._store.load(digest), self._config_weigher.device
        # How few centroids will do is a matter of the weights.
        return weigher.in_form(form_of(self._node.config, weigher)) if device is None else weigher.on(device)


def _handler(
    handlers: dict[str, Callable[[zenoh.Query], bytes | None]], query: zenoh.Query
) -> Callable[[zenoh.Query], bytes | None]:
    wanted = query.parameters.get("do") or ""
    if wanted not in handlers:
        raise InputError(f"parameter do={wanted}: give one of {', '.join(handlers)}")
    return handlers[wanted]


def _digest(query: zenoh.Query) -> str:
    text = query.parameters.get("digest") or ""
    if not _DIGEST.fullmatch(text):
        raise InputError(f"parameter digest={text[:80]}: give the 64 hex digits of a SHA-256")
    return text


def _whole(query: zenoh.Query, name: str) -> int:
    text = query.parameters.get(name) or ""
    if not text.isascii() or not text.isdigit() or len(text) > 16 or int(text) > LARGEST_ORDER:
        raise InputError(f"parameter {name}={text[:20]}: give a whole number from 0 to {LARGEST_ORDER}")
    return int(text)
