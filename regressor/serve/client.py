"""Gives a running line new weights: tried by every regressor first, then taken by all, or by none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import zenoh

from conveyor.errors import InputError, LinkError, TuberlineError
from regressor.serve.link import check, fetch, send, states, take
from regressor.serve.messages import WeightsReport, WeightsState, digest_of


@dataclass(frozen=True, slots=True)
class Changed:
    """What came of it.

    Attributes:
        n: number of the order; of the one that holds already where nothing had to be done.
        reports: of the regressors that tried the weights.
        before, after: what each regressor weighed with, and weighs with now.
        missed: regressors that did not take over, and why; they follow by themselves when they are back.
    """

    n: int
    reports: tuple[WeightsReport, ...]
    before: dict[str, WeightsState]
    after: dict[str, WeightsState]
    missed: dict[str, str]


def all_states(session: zenoh.Session, line: str) -> dict[str, WeightsState]:
    """What each regressor of the line weighs with.

    Raises:
        LinkError: none is there.
    """
    found = states(session, line)
    if not found:
        raise LinkError(
            f"no regressor of line '{line}' answers: is one running (`tuberline status`), and may you ask "
            "(access.keepers and access.operators)?"
        )
    return found


def newest(found: dict[str, WeightsState]) -> WeightsState:
    """The state by the order that holds."""
    return max(found.values(), key=lambda state: (state.n, state.digest))


def use(
    session: zenoh.Session, line: str, parcel: bytes, *, tell: Callable[[str], None] = lambda _text: None
) -> Changed:
    """Let every regressor of the line weigh with `parcel`. `tell` hears what is being done.

    Raises:
        InputError: a regressor refuses them; nothing was changed then.
        LinkError: no regressor answers, or one stopped answering before anything was changed.
    """
    digest, before = digest_of(parcel), all_states(session, line)
    if all(state.digest == digest for state in before.values()):
        return Changed(newest(before).n, (), before, before, {})
    reports = []
    for name in before:
        tell(f"{name} tries them")
        send(session, line, name, parcel)
        try:
            reports.append(check(session, line, name, digest))
        except InputError as error:
            raise InputError(f"regressor {name} refuses: {error}. Nothing was changed: all go on as before") from error
    n = newest(before).n + 1
    after, missed = {}, {}
    for name in before:
        try:
            after[name] = take(session, line, name, digest, n)
        except TuberlineError as error:
            missed[name] = str(error)
    if not after:
        raise LinkError(f"no regressor took the weights over: {'; '.join(missed.values())}")
    return Changed(n, tuple(reports), before, after, missed)


def rollback(session: zenoh.Session, line: str, *, tell: Callable[[str], None] = lambda _text: None) -> Changed:
    """Let every regressor weigh with what it weighed with before the last order.

    Raises:
        InputError: there is nothing to go back to.
        LinkError: no regressor answers.
    """
    state = newest(all_states(session, line))
    if not state.previous_digest:
        raise InputError(
            f"line '{line}' has been given no new weights since it started with {state.model}: nothing to go back to"
        )
    tell(f"back to {state.previous_model}, which {state.regressor} has kept")
    return use(session, line, fetch(session, line, state, state.previous_digest), tell=tell)
