"""Checks that somebody sends the alarms of a line."""

from __future__ import annotations

import socket
from collections.abc import Mapping

from conveyor.config import LineConfig
from conveyor.messages import Counters
from tuberline.alarms.outbox import alarms_folder, is_in_use
from tuberline.doctor.finding import Finding, ok, warning


def check_alarms(config: LineConfig, nodes: Mapping[str, Counters], *, alive: set[str]) -> list[Finding]:
    """`tuberline alarms` runs where the ledger is, which is where it is started; nothing is said on other hosts."""
    ledger = nodes.get("aggregator/aggregator")
    if config.alarms is None or ledger is None or "aggregator/aggregator" not in alive:
        return []
    if ledger.host != socket.gethostname():
        return []
    match is_in_use(alarms_folder(config)):
        case True:
            return [ok("alarms", "a process of this host sends them")]
        case False:
            return [
                warning(
                    "alarms",
                    "the config has [alarms], and no process of the ledger's host sends them",
                    f"start it: `tuberline alarms LINE.toml`, or systemctl start tuberline-alarms@{config.name}; that "
                    "it works says `tuberline alarms LINE.toml --test`",
                )
            ]
    return []
