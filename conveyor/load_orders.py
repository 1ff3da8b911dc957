"""Asks a line's aggregator to start, end, note, weigh or undo a load, until it answers: for commands, pages, sensors.

    order = LoadOrder(new_request(), "start", by="gate", fields={"name": "trailer 7"})
    with open_client(link, name="loader") as session:
        answer = send_order(session, line, order)

`give_order` does both, and counts the time until the router is there as the order's.

An order is answered when it is durable in the ledger. It may be sent any number of times: under one id it is done once,
and it is about the moment at which it was first sent, however long the answer took.
"""

from __future__ import annotations

import secrets
import time
from dataclasses import replace
from typing import Any

import zenoh

from conveyor import topics
from conveyor.config import LinkConfig
from conveyor.errors import InputError, LinkError, UnsendableError
from conveyor.messages import LoadAnswer, LoadOrder
from conveyor.session import open_client, refusal_of

LOADER = "loader"
TRY_S = 3.0
AGAIN_S = 0.2
LONGEST_S = 3600.0


def new_request() -> str:
    """An id for an order, unique; one is kept for all tries of one order."""
    return f"order-{secrets.token_hex(12)}"


def check_order(order: LoadOrder) -> None:
    """For what a person typed: find out before a line is asked.

    Raises:
        InputError: no line would take it; with the value and what is allowed.
    """
    try:
        order.check()
    except UnsendableError as error:
        said = str(error).removeprefix("not sent: LoadOrder.")
        raise InputError(f"such an order cannot be given: {said}") from error


def give_order(link: LinkConfig, line: str, order: LoadOrder, *, within_s: float = 20.0) -> LoadAnswer:
    """Join `line` as a loader, and the answer to `order`. A router that is not there is waited for as well, for the
    link's `connect_timeout_s`: meanwhile the belt moves on, and the order is about the moment of this call.

    Raises:
        ConfigError: no certificate of a loader.
        LinkError: no router in that time, no answer within `within_s` of its coming, or no right to ask.
    """
    began_s = time.monotonic()
    with open_client(link, name=LOADER) as session:
        age_s = min(order.age_s + time.monotonic() - began_s, LONGEST_S)
        return send_order(session, line, replace(order, age_s=age_s), within_s=within_s)


def send_order(session: zenoh.Session, line: str, order: LoadOrder, *, within_s: float = 20.0) -> LoadAnswer:
    """The aggregator's answer: `done`, or refused with its `error` in words.

    Raises:
        LinkError: no answer within `within_s`. It may have been carried out: the same `request` again tells.
    """
    key, began_s = topics.ORDER_LOAD.key(line), time.monotonic()
    found: LoadAnswer | None = None
    while (spent_s := time.monotonic() - began_s) < within_s:
        asked = replace(order, age_s=min(order.age_s + spent_s, LONGEST_S))
        found = _ask(session, key, asked, timeout_s=min(TRY_S, max(within_s - spent_s, 0.1)))
        if found is not None and not found.later:
            return found
        time.sleep(AGAIN_S)
    if found is not None:  # the last try was answered, too: it was not carried out
        return found
    raise LinkError(
        f"no answer to order {order.request} within {within_s:g} s: is the aggregator of line '{line}' up, and may "
        "this certificate change loads (access.loaders)? Ask again with the same request: it is done once"
    )


def _ask(session: zenoh.Session, key: str, order: LoadOrder, *, timeout_s: float) -> LoadAnswer | None:
    replies: Any = session.get(
        key, payload=order.encode(), timeout=timeout_s, consolidation=zenoh.ConsolidationMode.NONE
    )
    for reply in replies:
        if reply.ok is not None:
            return LoadAnswer.decode(reply.ok.payload.to_bytes())
        text = refusal_of(reply.err)
        if "imeout" not in text:
            raise LinkError(f"the order is refused: {text}")
    return None
