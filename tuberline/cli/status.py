"""`tuberline status`: a running line's totals and nodes, once."""

from __future__ import annotations

import json as json_module
import sys
import time
from dataclasses import asdict
from typing import Annotated

from conveyor.observer import Observer
from tuberline.cli.address import NO_ADDRESS, LineAddress
from tuberline.cli.numbers import within


def status(
    *, address: LineAddress = NO_ADDRESS, json: bool = False, wait_s: Annotated[float, within(0, 3600, "s")] = 1.5
) -> None:
    """Print totals and nodes of a running line. Without its aggregator, what its ledger holds, where that is here.

    Parameters
    ----------
    json
        For machines.
    wait_s
        How long to listen.
    """
    from tuberline.cli.last_known import last_known, told_without_aggregator
    from tuberline.cli.live import AGGREGATOR, line_table
    from tuberline.doctor.line import expected_nodes

    link, name = address.link()
    expected = expected_nodes(address.loaded()) if address.config else set()
    with Observer(link, line=name) as observer:
        time.sleep(wait_s)
        totals, nodes, alive = observer.totals(), observer.nodes(), observer.alive()
    away = AGGREGATOR not in alive
    known = last_known(address) if away else None
    if json:
        report = {
            "line": name,
            "totals": asdict(totals) if totals else None,
            "last_known": known,
            "nodes": {key: {**asdict(value), "alive": key in alive} for key, value in sorted(nodes.items())},
            "missing": sorted(expected - alive),
        }
        sys.stdout.write(json_module.dumps(report, indent=2) + "\n")
        return
    from rich.console import Console

    nothing = told_without_aggregator(known) if away else ""
    Console().print(line_table(totals, nodes, alive=alive, expected=expected, nothing=nothing))
