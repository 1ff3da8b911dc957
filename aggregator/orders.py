"""Orders about loads, from the link to the ledger: each is durable before it is answered, and done once.

They arrive on Zenoh's threads and are carried out by the one thread that writes, between two commits. An order whose
place on the belt is not known yet waits for it; the asker asks again under the same id until it has an answer.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import zenoh

from aggregator.calibration.correction import stated_mm
from aggregator.core.line_place import NotYetKnownError, place_now_x_m
from aggregator.core.load_orders import answer, decide, refusal
from aggregator.core.loads import LoadEvent
from aggregator.core.machine import Aggregation
from aggregator.ledger.writer import Ledger
from conveyor import topics
from conveyor.errors import InputError, MessageError
from conveyor.messages import LoadAnswer, LoadOrder
from conveyor.node import Node

MOST_WAITING = 64
PATIENCE_S = 2.5
"""For so long an order waits to know where the belt is; within that its asker listens (`conveyor.load_orders`)."""


class Orders:
    """The queryable of an aggregator that takes orders about loads."""

    def __init__(
        self, node: Node, ledger: Ledger, core: Aggregation, *, remark: Callable[[LoadEvent, float], str]
    ) -> None:
        """`remark`: what is to be said of a ticket that was entered; '' where nothing is."""
        self._node = node
        self._ledger = ledger
        self._core = core
        self._remark = remark
        self._stated_offset_mm = stated_mm(node.config.belt.model_dump())
        self._lock = threading.Lock()
        self._said_s: dict[int, float] = {}
        self._waiting: deque[tuple[float, LoadOrder, zenoh.Query]] = deque()
        for name in ("load_orders_done", "load_orders_refused", "load_orders_malformed"):
            node.counters.add(name, 0)
        self._key = topics.ORDER_LOAD.key(node.line)
        self._queryable = node.session.declare_queryable(
            self._key, zenoh.handlers.Callback(self._arrived, indirect=True)
        )

    @property
    def waiting(self) -> bool:
        """Some order is to be carried out."""
        return bool(self._waiting)

    def hold_at_x_m(self, now_s: float) -> float:
        """No tuber further along the belt may be committed: a load is to change there. Minus infinity where none is;
        infinity where it is not known yet: all that a line did while its aggregator was away comes at once, and an
        order given meanwhile needs a second until it can be laid.
        """
        with self._lock:
            waiting = list(self._waiting)
        places_m = [-math.inf]
        for came_s, order, _query in waiting:
            if order.action not in ("start", "end") or order.request in self._ledger.loads.events:
                continue
            if order.place_x_m is None and self._core.cameras.final:  # all of the belt comes before it
                continue
            try:
                places_m.append(self._place_x_m(order, came_s, now_s))
            except NotYetKnownError:
                places_m.append(math.inf)
            except InputError:  # it is refused
                continue
        return max(places_m)

    def _arrived(self, query: zenoh.Query) -> None:
        """On a thread of Zenoh's: read the order and let the main loop have it."""
        try:
            order = LoadOrder.decode(query.payload.to_bytes() if query.payload is not None else b"")
        except MessageError as error:
            self._node.counters.add("load_orders_malformed")
            self._node.log.error("an order about a load cannot be read: %s", error)
            with query:
                query.reply_err(str(error))
            return
        with self._lock:
            busy = len(self._waiting) >= MOST_WAITING
            if not busy:
                self._waiting.append((time.monotonic(), order, query))
        if busy:
            self._reply(query, refusal(order, InputError(f"{MOST_WAITING} orders wait already: ask again")))

    def carry_out(self, now_s: float) -> None:
        """Carry out what waits, each durable before its answer; what the belt must tell first stays waiting."""
        with self._lock:
            orders, self._waiting = list(self._waiting), deque()
        for came_s, order, query in orders:
            try:
                told = self._one(order, came_s, now_s)
            except NotYetKnownError as error:
                if now_s - came_s < PATIENCE_S:
                    with self._lock:
                        self._waiting.append((came_s, order, query))
                    continue
                told = refusal(order, error, later=True)
            except InputError as error:
                told = refusal(order, error)
            if not told.done:
                self._node.counters.add("load_orders_refused")
                self._node.log.warning("refused to %s a load (%s): %s", order.action, order.by, told.error)
            self._reply(query, told)

    def _one(self, order: LoadOrder, came_s: float, now_s: float) -> LoadAnswer:
        known = order.request in self._ledger.loads.events
        event = decide(
            order,
            self._ledger.loads,
            run=self._core.run,
            now_ns=time.time_ns(),
            line={"utc_offset_s": time.localtime().tm_gmtoff, "stated_offset_mm": self._stated_offset_mm},
            place_x_m=lambda asked: self._place_x_m(asked, came_s, now_s),
            ago_s=lambda event: now_s - self._said_s[event.n] if event.n in self._said_s else None,
        )
        if not known:
            self._ledger.say(event)
            self._said_s[event.n] = now_s
            self._core.cameras.loads_change()
            self._node.counters.add("load_orders_done")
            self._told(event)
        return answer(order, event, self._ledger.loads, remark=self._remark(event, now_s))

    def _place_x_m(self, order: LoadOrder, came_s: float, now_s: float) -> float:
        """As `order_place_x_m`, of an order that came at `came_s`."""
        aged = replace(order, age_s=order.age_s + now_s - came_s)
        return order_place_x_m(aged, self._ledger, self._core, now_s)

    def _told(self, event: LoadEvent) -> None:
        place = f" {event.where}" if event.where else ""
        self._node.log.info("%s of load %d%s by %s", event.kind, event.load, place, event.said_by or "unknown")

    def _reply(self, query: zenoh.Query, told: LoadAnswer) -> None:
        try:
            with query:  # dropped when answered: else the asker waits for its whole timeout
                query.reply(self._key, told.encode())
        except zenoh.ZError as error:  # who asked is gone; under the same id it learns what became of it
            self._node.log.warning("an answer about a load did not arrive: %s", error)


def order_place_x_m(order: LoadOrder, ledger: Ledger, core: Aggregation, now_s: float) -> float:
    """Where on the belt an order changes loads: never where tubers are committed, nor before the last change.

    Raises:
        NotYetKnownError: where the belt is, is not known yet. InputError: it cannot change there, or any more.
    """
    spans = ledger.loads.spans.get(core.run, [])
    latest_x_m = min([core.watermark_x_m, *(span.from_x_m for span in spans[-1:])])
    if order.place_x_m is None:
        if order.action == "end" and core.cameras.final:
            return latest_x_m
        return min(place_now_x_m(core.cameras, now_s=now_s, age_s=order.age_s), latest_x_m)
    if order.place_x_m > latest_x_m:
        taken = "all belt of this run" if latest_x_m == -math.inf else f"belt down to {latest_x_m:.2f} m"
        raise InputError(
            f"a load cannot change at {order.place_x_m:.2f} m: {taken} is committed or belongs to the load before; "
            "places fall as the belt runs"
        )
    return order.place_x_m


def answer_all(orders: Orders, commit: Callable[[], None], now_s: float) -> None:
    """Commit what is applied, so that no tuber lies beyond where a load changes, then carry out what waits."""
    if orders.waiting:
        commit()
        orders.carry_out(now_s)
