"""Has lines carry out what a browser asked for, as a loader: with a certificate other than the one the page looks with.

A session lives as long as its order: a page that no one acts on holds no rights at a router.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from conveyor.config import LinkConfig
from conveyor.errors import ConfigError
from conveyor.load_orders import LONGEST_S, send_order
from conveyor.messages import LoadAnswer, LoadOrder
from conveyor.session import client_settings, open_client

LOADER = "loader"
ANSWER_WITHIN_S = 12.0
CONNECT_WITHIN_S = 5.0


class Orders:
    """Orders to the lines of a page, by name. `asked` hears of each that was answered."""

    def __init__(self, links: Mapping[str, LinkConfig], *, asked: Callable[[str], None]) -> None:
        self._links = {
            line: link.model_copy(update={"connect_timeout_s": CONNECT_WITHIN_S}) for line, link in links.items()
        }
        self._asked = asked

    def carry(self, line: str, order: LoadOrder) -> LoadAnswer:
        """The aggregator's answer.

        Raises:
            ConfigError: no certificate of a loader.
            LinkError: no router, no answer, or no right to ask.
        """
        began_s = time.monotonic()
        with open_client(self._links[line], name=LOADER) as session:
            age_s = min(order.age_s + time.monotonic() - began_s, LONGEST_S)
            answer = send_order(session, line, replace(order, age_s=age_s), within_s=ANSWER_WITHIN_S)
        self._asked(line)
        return answer


def why_not(link: LinkConfig) -> str:
    """Why this machine has no right to change the loads at `link`; '' where it may try, the router decides."""
    try:
        client_settings(link, name=LOADER)
    except ConfigError as error:
        return str(error)
    return ""
