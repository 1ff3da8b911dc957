"""`tuberline status`: a running line's totals and nodes, once."""

from __future__ import annotations

import json as json_module
import sys
import time
from collections.abc import Mapping, Set
from dataclasses import asdict
from typing import Annotated, Any

from conveyor.errors import LinkError
from conveyor.lines import seen_beside
from conveyor.messages import Counters, Totals
from conveyor.observer import Observer
from tuberline.cli.address import NO_ADDRESS, LineAddress
from tuberline.cli.numbers import within


def status(
    *, address: LineAddress = NO_ADDRESS, json: bool = False, wait_s: Annotated[float, within(0, 3600, "s")] = 1.5
) -> None:
    """Print totals and nodes of a running line. Without its aggregator, what its ledger holds, where that is here; so
    of a line that does not run, with exit code 75.

    Parameters
    ----------
    json
        For machines.
    wait_s
        How long to listen.
    """
    from tuberline.cli.last_known import last_known, ledger_line, told_without_aggregator
    from tuberline.cli.live import AGGREGATOR, line_table
    from tuberline.doctor.line import check_name, expected_nodes

    link, name = address.link()
    expected = expected_nodes(address.loaded()) if address.config else set()
    try:
        with Observer(link, line=name) as observer:
            time.sleep(wait_s)
            totals, nodes, alive = observer.totals(), observer.nodes(), observer.alive()
            lines = {} if json else seen_beside(observer.session, name, alive)
    except LinkError:
        if (known := last_known(address)) is not None:
            _tell(_report(name, None, known, {}, set(), expected) if json else ledger_line(known))
        raise
    away = AGGREGATOR not in alive
    known = last_known(address) if away else None
    if json:
        _tell(_report(name, totals, known, nodes, alive, expected))
        return
    nothing = told_without_aggregator(known) if away else ""
    _tell(line_table(totals, nodes, alive=alive, expected=expected, nothing=nothing))
    for finding in check_name(name, lines):
        _tell(f"{finding.text}: {finding.fix}")


def _report(
    line: str,
    totals: Totals | None,
    known: dict[str, Any] | None,
    nodes: Mapping[str, Counters],
    alive: Set[str],
    expected: Set[str],
) -> dict[str, Any]:
    return {
        "line": line,
        "totals": asdict(totals) if totals else None,
        "last_known": known,
        "nodes": {key: {**asdict(value), "alive": key in alive} for key, value in sorted(nodes.items())},
        "missing": sorted(expected - alive),
    }


def _tell(found: Any) -> None:
    """A report as JSON, anything else as a person reads it."""
    if isinstance(found, dict):
        sys.stdout.write(json_module.dumps(found, indent=2) + "\n")
        return
    from rich.console import Console

    Console().print(found)
