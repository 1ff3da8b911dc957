"""Questions between a line's keepers and regressors: small, one after the other, never in the way of a view.

Weights travel in pieces that fit one packet of the link, the next one asked for when the last one is there: at the
lowest priority they fill what is left of a slow link and no queue, and a piece that is lost is sent again.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import zenoh

from conveyor.errors import InputError, LinkError, MessageError
from conveyor.session import refusal_of
from conveyor.topics import ORDER_MODEL, QUERY_MODEL, Topic
from regressor.serve.messages import MAX_PARCEL_BYTES, WeightsReport, WeightsState, digest_of

PIECE_BYTES = 48 << 10
PIECE_TIMEOUT_S, PIECE_ATTEMPTS = 3.0, 4
STATE_TIMEOUT_S = 2.0
CHECK_TIMEOUT_S = 30.0
"""A check waits for the view in hand, loads the weights and weighs the reference clouds: under a second, mostly."""


def states(session: zenoh.Session, line: str, *, timeout_s: float = STATE_TIMEOUT_S) -> dict[str, WeightsState]:
    """What each regressor of the line weighs with, by its name; those that do not answer in time are missing.

    So are those that refuse to say, or say it in words of another version: they neither follow nor are followed.
    """
    found = {}
    for reply in _ask(session, QUERY_MODEL, line, "*", {"do": "state"}, timeout_s=timeout_s):
        with suppress(MessageError):
            if isinstance(reply, bytes):
                state = WeightsState.decode(reply)
                found[state.regressor] = state
    return dict(sorted(found.items()))


def fetch(session: zenoh.Session, line: str, state: WeightsState, digest: str) -> bytes:
    """The parcel `digest` from the regressor of `state`.

    Raises:
        LinkError: it does not answer, or what it sent is something else.
        InputError: it does not have it.
    """
    data, piece = bytearray(), b"."
    while piece and len(data) <= MAX_PARCEL_BYTES:
        parameters = {"do": "piece", "digest": digest, "offset": str(len(data))}
        piece = _one(session, QUERY_MODEL, line, state.regressor, parameters)
        data += piece
    if digest_of(bytes(data)) != digest:
        raise LinkError(f"regressor {state.regressor} sent {len(data)} bytes that are not the weights {digest[:16]}")
    return bytes(data)


def send(session: zenoh.Session, line: str, regressor: str, parcel: bytes) -> None:
    """Give a regressor a parcel; nothing changes yet.

    Raises:
        LinkError: it does not answer.
        InputError: it refuses.
    """
    digest, have = digest_of(parcel), 0
    while have < len(parcel):
        parameters = {"do": "piece", "digest": digest, "offset": str(have), "size": str(len(parcel))}
        answer = _one(session, ORDER_MODEL, line, regressor, parameters, payload=parcel[have : have + PIECE_BYTES])
        before, have = have, int(answer)
        if have == before:
            raise LinkError(f"regressor {regressor} takes no more than {have} of {len(parcel)} bytes")


def check(session: zenoh.Session, line: str, regressor: str, digest: str) -> WeightsReport:
    """Let a regressor try a parcel that it has.

    Raises:
        LinkError: it does not answer.
        InputError: it refuses these weights; says why.
    """
    parameters = {"do": "check", "digest": digest}
    return WeightsReport.decode(_one(session, ORDER_MODEL, line, regressor, parameters, timeout_s=CHECK_TIMEOUT_S))


def take(session: zenoh.Session, line: str, regressor: str, digest: str, n: int) -> WeightsState:
    """Let a regressor change over to a parcel that it has, by order `n`.

    Raises:
        LinkError: it does not answer.
        InputError: it refuses; says why.
    """
    parameters = {"do": "take", "digest": digest, "n": str(n)}
    return WeightsState.decode(_one(session, ORDER_MODEL, line, regressor, parameters, timeout_s=CHECK_TIMEOUT_S))


def _one(
    session: zenoh.Session,
    topic: Topic,
    line: str,
    regressor: str,
    parameters: dict[str, str],
    *,
    payload: bytes | None = None,
    timeout_s: float = PIECE_TIMEOUT_S,
) -> bytes:
    """The answer of one regressor. Every question may be asked twice: the second time changes nothing."""
    for _ in range(PIECE_ATTEMPTS):
        for reply in _ask(session, topic, line, regressor, parameters, payload=payload, timeout_s=timeout_s):
            if isinstance(reply, InputError):
                raise reply
            return reply
    raise LinkError(
        f"regressor {regressor} of line '{line}' does not answer '{parameters['do']}': has it stopped, or may you not "
        "ask (access.keepers)?"
    )


def _ask(
    session: zenoh.Session,
    topic: Topic,
    line: str,
    regressor: str,
    parameters: dict[str, str],
    *,
    payload: bytes | None = None,
    timeout_s: float,
) -> Iterator[bytes | InputError]:
    """Every answer; of a refusal its text as an error."""
    replies = session.get(
        zenoh.Selector(topic.key(line, regressor=regressor), parameters),
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.DATA_LOW,
        payload=payload,
        timeout=timeout_s,
    )
    for reply in replies:
        if reply.ok is not None:
            yield reply.ok.payload.to_bytes()
        elif reply.err is not None and (why := refusal_of(reply.err)) != "Timeout":
            yield InputError(why)
