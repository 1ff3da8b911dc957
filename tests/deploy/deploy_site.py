"""A small site with certificates and access rules: a real router session and real client sessions over TLS."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import zenoh

from conveyor.access import line_identities, router_access
from conveyor.config import LineConfig, parse_config
from conveyor.counters import CounterSet
from conveyor.identity import Identity
from conveyor.session import open_client, open_router
from tuberline.certs import issue, make_authority


@dataclass
class Peer:
    """An open session on the line: what the delivery classes need."""

    session: zenoh.Session
    line: str
    counters: CounterSet = field(default_factory=CounterSet)
    log: logging.Logger = field(default_factory=lambda: logging.getLogger("peer"))


@dataclass
class Site:
    """A line whose router runs; `join` gives sessions that are closed when the site is."""

    config: LineConfig
    certs: Path
    stack: ExitStack

    def join(self, node: str, *, config: LineConfig | None = None) -> Peer:
        """A session of `node`, e.g. 'camera/front', with its own certificate."""
        config = config or self.config
        session = open_client(config.link, name=node)
        self.stack.callback(session.close)
        return Peer(session, config.name)


def site_config(port: int, certs: Path) -> LineConfig:
    """Two cameras, two regressors, TLS and access control."""
    return parse_config(
        {
            "name": "north",
            "link": {"router": f"tls/127.0.0.1:{port}", "certs": str(certs), "connect_timeout_s": 5.0},
            "access": {"enabled": True, "encoders": ["wheel"]},
            "cameras": {"front": {}, "rear": {}},
        },
        where="of this test",
    )


def make_certs(config: LineConfig, folder: Path) -> None:
    """Everything `tuberline certs make` makes."""
    make_authority(folder, site=config.name)
    issue(folder, Identity("router"), line=config.name, hosts=["127.0.0.1", "localhost"])
    for identity in line_identities(config):
        issue(folder, identity, line=config.name)


@contextmanager
def running_site(config: LineConfig, certs: Path) -> Iterator[Site]:
    """The site with its router up."""
    with ExitStack() as stack:
        router = open_router(config.link, access_control=router_access(config))
        stack.callback(router.close)
        yield Site(config, certs, stack)
