"""`tuberline top`: a running line's totals and nodes, live."""

from __future__ import annotations

from pathlib import Path

from conveyor.cli.status import line_address
from conveyor.observer import Observer


def top(*, config: Path | None = None, connect: str | None = None, line: str | None = None) -> None:
    """Watch totals and nodes of a running line; Ctrl-C ends it and changes nothing.

    Parameters
    ----------
    config
        The line's TOML file.
    connect
        Endpoint of its router, e.g. tcp/10.0.0.1:7447; instead of a config.
    line
        Name of the line, where no config says it.
    """
    from rich.live import Live

    from conveyor.cli.live import Pace, line_table

    link, name = line_address(config, connect, line)
    pace = Pace()
    with Observer(link, line=name) as observer, Live(refresh_per_second=4, screen=True) as live:
        while True:
            observer.wait_totals(0.5)
            nodes = observer.nodes()
            pace.update(nodes)
            live.update(line_table(observer.totals(), nodes, alive=observer.alive(), pace=pace))
