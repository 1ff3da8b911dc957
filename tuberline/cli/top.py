"""`tuberline top`: a running line's totals and nodes, live."""

from __future__ import annotations

from conveyor.observer import Observer
from tuberline.cli.address import NO_ADDRESS, LineAddress


def top(*, address: LineAddress = NO_ADDRESS) -> None:
    """Watch totals and nodes of a running line; Ctrl-C ends it and changes nothing."""
    from rich.live import Live

    from tuberline.cli.live import Pace, line_table

    link, name = address.link()
    pace = Pace()
    with Observer(link, line=name) as observer, Live(refresh_per_second=4, screen=True) as live:
        while True:
            observer.wait_totals(0.5)
            nodes = observer.nodes()
            pace.update(nodes)
            live.update(line_table(observer.totals(), nodes, alive=observer.alive(), pace=pace))
