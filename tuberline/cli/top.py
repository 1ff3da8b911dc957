"""`tuberline top`: a running line's totals and nodes, live."""

from __future__ import annotations

from conveyor.observer import Observer
from tuberline.cli.address import NO_ADDRESS, LineAddress

DRAWN_EVERY_S = 1.0
"""Every node reports once a second. A picture of it has some kilobytes, which ssh carries over a slow link, too."""
LOGGED_EVERY_S = 10.0
"""Into a file or a pipe the table is written again after so long: a screen that is drawn over means nothing there."""


def top(*, address: LineAddress = NO_ADDRESS) -> None:
    """Watch totals and nodes of a running line; Ctrl-C ends it and changes nothing.

    Into a file or a pipe, the table is written every 10 s.
    """
    import time
    from contextlib import nullcontext

    from rich.console import Console
    from rich.live import Live

    from tuberline.cli.last_known import last_known, told_without_aggregator
    from tuberline.cli.live import AGGREGATOR, Pace, line_table
    from tuberline.doctor.line import expected_nodes

    expected = expected_nodes(address.loaded()) if address.config else set()
    link, name = address.link()
    pace, console, nothing = Pace(), Console(), ""
    drawn = Live(console=console, auto_refresh=False, screen=True) if console.is_terminal else None
    drawn_s = -DRAWN_EVERY_S
    with Observer(link, line=name) as observer, drawn or nullcontext():
        while True:
            observer.wait_totals(0.5)
            totals, nodes, alive = observer.totals(), observer.nodes(), observer.alive()
            pace.update(nodes)
            if drawn and time.monotonic() - drawn_s < DRAWN_EVERY_S:
                continue
            if AGGREGATOR in alive:
                nothing = ""
            elif totals is None and not nothing:  # no one writes to the ledger: it is read once
                nothing = told_without_aggregator(last_known(address))
            table = line_table(totals, nodes, alive=alive, pace=pace, expected=expected, nothing=nothing)
            if drawn:
                drawn.update(table, refresh=True)
                drawn_s = time.monotonic()
            else:
                console.print(table)
                time.sleep(LOGGED_EVERY_S)
