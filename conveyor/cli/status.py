"""`tuberline status`: a running line's totals and nodes, once."""

from __future__ import annotations

import json as json_module
import sys
import time
from dataclasses import asdict
from pathlib import Path

from conveyor.config import LineConfig, LinkConfig, load_config
from conveyor.observer import Observer


def line_address(config: Path | None, connect: str | None, line: str | None) -> tuple[LinkConfig, str]:
    """Where a line is watched: from its config, or from an endpoint and a line name."""
    loaded = load_config(config) if config else LineConfig()
    link = loaded.link.model_copy(update={"connect_timeout_s": 5.0, **({"router": connect} if connect else {})})
    return link, line or loaded.name


def status(
    *,
    config: Path | None = None,
    connect: str | None = None,
    line: str | None = None,
    json: bool = False,
    wait_s: float = 1.5,
) -> None:
    """Print totals and nodes of a running line.

    Parameters
    ----------
    config
        The line's TOML file.
    connect
        Endpoint of its router, e.g. tcp/10.0.0.1:7447; instead of a config.
    line
        Name of the line, where no config says it.
    json
        For machines.
    wait_s
        How long to listen.
    """
    link, name = line_address(config, connect, line)
    with Observer(link, line=name) as observer:
        time.sleep(wait_s)
        totals, nodes, alive = observer.totals(), observer.nodes(), observer.alive()
    if json:
        report = {
            "line": name,
            "totals": asdict(totals) if totals else None,
            "nodes": {key: {**asdict(value), "alive": key in alive} for key, value in sorted(nodes.items())},
        }
        sys.stdout.write(json_module.dumps(report, indent=2) + "\n")
        return
    from rich.console import Console

    from conveyor.cli.live import line_table

    Console().print(line_table(totals, nodes, alive=alive))
