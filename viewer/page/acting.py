"""Orders from a browser: who may give them, how often, and what one may say. What is carried out, `orders` knows."""

from __future__ import annotations

import asyncio
import hmac
import json
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response

from conveyor.errors import InputError, TuberlineError
from conveyor.load_orders import check_order
from conveyor.messages import LoadAnswer, LoadOrder
from conveyor.messages.loads import FIELDS

MAX_BODY_BYTES = 4096
BODY_WITHIN_S = 5.0
MAX_ASKED, ASKED_WITHIN_S = 20, 60.0
"""Orders of one address, right and wrong ones: a hand gives a few an hour."""
MAX_ADDRESSES = 256
LEAST_TOKEN = 16
TOKEN_HEADER = "x-tuberline-token"
"""Not Authorization: behind a proxy that holds its own password. No other page's form or image can send it."""
ACTIONS = ("start", "end", "undo", "ticket", "note")
MAX_OPERATOR = 60
GIVEN = frozenset({"line", "action", "request", "operator", "age_s", "load", "fields", "kg", "net", "note"})

Carry = Callable[[str, LoadOrder], LoadAnswer]
"""Has a line carry out an order, and waits for the answer; raises TuberlineError where there is none."""


@dataclass(slots=True)
class Rate:
    """So many a minute for each address; of more addresses than have a place the oldest is forgotten."""

    most: int = MAX_ASKED
    within_s: float = ASKED_WITHIN_S
    _asked: dict[str, deque[float]] = field(default_factory=dict)

    def take(self, address: str, now_s: float) -> bool:
        """One more of `address`; False where it is too many."""
        asked = self._asked.pop(address, deque())
        self._asked[address] = asked
        while len(self._asked) > MAX_ADDRESSES:
            del self._asked[next(iter(self._asked))]
        while asked and now_s - asked[0] >= self.within_s:
            asked.popleft()
        if len(asked) >= self.most:
            return False
        asked.append(now_s)
        return True


class Acting:
    """Answers POST /order with JSON: {"done", "text", "error", "later", "load", "name"}. One order of a line at a time.

    `later`: the line could not tell yet, and a try of the order may still be carried out.
    """

    def __init__(self, carry: Carry, *, lines: tuple[str, ...], token: str) -> None:
        if len(token) < LEAST_TOKEN:
            raise InputError(f"the page's token has {len(token)} characters; give at least {LEAST_TOKEN}")
        self._carry = carry
        self._token = token.encode()
        self._rate = Rate()
        self._busy = {line: asyncio.Lock() for line in lines}

    async def __call__(self, request: Request) -> Response:
        """Take an order, or refuse it in words."""
        if not own_origin(request):  # not counted: a page elsewhere could use up what a minute has room for
            return _refused(403, "The order comes from another page.")
        address = request.client.host if request.client else ""
        if not self._rate.take(address, time.monotonic()):
            return _refused(429, f"Too many orders: at most {MAX_ASKED} a minute. Wait a minute and try again.")
        if not self._known(request.headers.get(TOKEN_HEADER, "")):
            return _refused(401, "This token is wrong. The right one stands where the page was started.")
        try:
            body = await asyncio.wait_for(_body(request), BODY_WITHIN_S)
            line, order = read_order(body)
        except (TimeoutError, ClientDisconnect):
            return _refused(408, "The order did not arrive in time. Try again.")
        except TuberlineError as error:
            return _refused(400, str(error))
        if line not in self._busy:
            return _refused(404, f"This page does not show a line '{line}'.")
        if self._busy[line].locked():
            return _refused(409, "Another order of this line is still under way. Wait for it, and try again.")
        async with self._busy[line]:
            try:
                found = await asyncio.to_thread(self._carry, line, order)
            except TuberlineError as error:
                return _refused(502, str(error))
        told = {"done": found.done, "text": found.text, "error": found.error, "later": found.later}
        return JSONResponse({**told, "load": found.load, "name": found.name})

    def _known(self, token: str) -> bool:
        return hmac.compare_digest(token.strip().encode("utf-8", "surrogateescape"), self._token)


def read_order(body: bytes) -> tuple[str, LoadOrder]:
    """(line, order) of a browser's JSON.

    Raises:
        InputError: no JSON object, keys that no order has, no operator, or a value that an order does not allow.
    """
    try:
        said: Any = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise InputError("the order is no JSON; load the page again") from error
    if not isinstance(said, dict) or not set(said) <= GIVEN:
        raise InputError(f"an order has the keys {', '.join(sorted(GIVEN))} and no others; load the page again")
    if said.get("action") not in ACTIONS:
        raise InputError(f"the page does not know how to '{said.get('action')}'; it can {', '.join(ACTIONS)}")
    operator, fields = said.get("operator"), said.get("fields", {})
    if not isinstance(operator, str) or not 0 < len(operator.strip()) <= MAX_OPERATOR:
        raise InputError(f"who gives the order? Type a name of at most {MAX_OPERATOR} characters")
    if not isinstance(fields, dict) or not set(fields) <= set(FIELDS):
        raise InputError(f"a load is described by {', '.join(FIELDS)}; load the page again")
    if said["action"] == "ticket" and said.get("kg") is None:
        raise InputError("type what the scale said, in kg")
    if said["action"] == "note" and not str(said.get("note", "")).strip():
        raise InputError("type what is to be noted")
    order = LoadOrder(
        request=said.get("request", ""),
        action=said["action"],
        by=f"page: {operator.strip()}",
        age_s=said.get("age_s", 0.0),
        load=said.get("load", ""),
        fields={name: text.strip() if isinstance(text, str) else text for name, text in fields.items() if text},
        kg=said.get("kg"),
        net=said.get("net", True),
        note=said.get("note", ""),
    )
    check_order(order)
    return str(said.get("line", "")), order


def own_origin(request: Request) -> bool:
    """The page that asks is this one, also behind a proxy of another name; programs say no origin."""
    origin = request.headers.get("origin")
    own = {request.headers.get(name, "") for name in ("host", "x-forwarded-host")} - {""}
    return origin is None or origin.partition("://")[2] in own


async def _body(request: Request) -> bytes:
    found = b""
    async for part in request.stream():
        found += part
        if len(found) > MAX_BODY_BYTES:
            raise InputError(f"the order has more than {MAX_BODY_BYTES} bytes")
    return found


def _refused(status: int, why: str) -> Response:
    return JSONResponse({"done": False, "text": "", "error": why, "load": 0, "name": ""}, status)
