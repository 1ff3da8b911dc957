"""Has lines carry out what a browser asked for, as a loader: with a certificate other than the one the page looks with.

A session lives as long as its order: a page that no one acts on holds no rights at a router.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from conveyor.config import LinkConfig
from conveyor.errors import ConfigError
from conveyor.load_orders import LOADER, give_order
from conveyor.messages import LoadAnswer, LoadOrder
from conveyor.session import client_settings

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
        answer = give_order(self._links[line], line, order, within_s=ANSWER_WITHIN_S)
        self._asked(line)
        return answer


def why_not(link: LinkConfig) -> str:
    """Why this machine has no right to change the loads at `link`; '' where it may try, the router decides."""
    try:
        client_settings(link, name=LOADER)
    except ConfigError as error:
        return str(error)
    return ""
