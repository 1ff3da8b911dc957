"""`tuberline page`: the operator's page of one line or several."""

from __future__ import annotations

import logging
import secrets
import sys
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from conveyor.errors import ConfigError
from conveyor.text_files import read_text
from tuberline.cli.address import LineAddress

if TYPE_CHECKING:
    from tuberline.maps.live import LiveMap
    from viewer.page.maps import FieldMaps

TICK_S = 1.0
NO_TOKEN = "it was started without a token (tuberline page --token-file FILE)"


def page(
    *,
    config: Annotated[tuple[Path, ...], Parameter(negative_iterable="")] = (),
    connect: str | None = None,
    line: Annotated[tuple[str, ...], Parameter(negative_iterable="")] = (),
    listen: str = "127.0.0.1:9180",
    token_file: Path | None = None,
) -> None:
    """Serve the operator's page: the load, the belt, cameras, alarms in plain words. Who has its token changes loads.

    Parameters
    ----------
    config
        A line's TOML file; given several times, the page shows several lines.
    connect
        Endpoint of a router, e.g. tcp/10.0.0.1:7447; instead of a config.
    line
        Names of the lines at that router, where no config says them.
    listen
        HOST:PORT to serve the page on. Beyond this machine only where everybody in the network may look; else put
        deploy/proxy before it.
    token_file
        A file with the token, at least 16 characters, that a browser needs to start and end loads and to enter
        tickets. Without one a terminal gets a new token at each start; elsewhere the page only looks, as with
        /dev/null. An empty file is refused.
    """
    from conveyor.access import known_nodes
    from conveyor.notify import notify
    from conveyor.served import ServedAt
    from conveyor.signals import stop_when_told
    from viewer.page.acting import Acting
    from viewer.page.board import Board
    from viewer.page.maps import FieldMaps
    from viewer.page.orders import Orders, why_not
    from viewer.page.pictures import Pictures
    from viewer.page.server import PageServer
    from viewer.page.snapshot import snapshot
    from viewer.page.watch import LineWatch

    at = ServedAt.parse(listen, option="--listen", example="127.0.0.1:9180")
    if config and (connect or line):
        raise ConfigError("give --config (once for each line), or --connect with --line, not both")
    addresses = [LineAddress(path) for path in config] or [LineAddress(None, connect, name) for name in line or (None,)]
    names = [address.link()[1] for address in addresses]
    if len(set(names)) < len(names):
        raise ConfigError(f"two of the lines have the same name: {', '.join(names)}; give each its own")
    stop = threading.Event()
    stop_when_told(stop)
    board, pictures, maps = Board(names), Pictures(), FieldMaps()
    links = {name: address.link()[0] for address, name in zip(addresses, names, strict=True)}
    token = _token(token_file)
    reasons = {name: why_not(link) if token else NO_TOKEN for name, link in links.items()}
    watches = [
        LineWatch(
            address.link()[0],
            line=name,
            tell=lambda look: board.put(
                {**snapshot(look), "looks_only": reasons[look.line], "map": maps.number(look.line)}
            ),
            known=known_nodes(address.loaded()) if address.config else (),
            pictures=pictures,
            maps=maps,
        )
        for address, name in zip(addresses, names, strict=True)
    ]
    asks = {watch.line: watch.ask_soon for watch in watches}
    orders = Orders(links, asked=lambda line: asks[line]())
    acting = Acting(orders.carry, lines=tuple(names), token=token) if token else None
    kept: list[LineWatch | LiveMap] = [*watches, *_live_maps(addresses, maps)]
    with PageServer(board, host=at.host, port=at.port, acting=acting, pictures=pictures, maps=maps) as server:
        for each in kept:
            each.start()
        logging.getLogger("page").info("%s at http://%s/", ", ".join(names), replace(at, port=server.port))
        if token and token_file is None:
            sys.stdout.write(f"To change loads, the page asks for this token: {token}\n")
            sys.stdout.flush()
        notify("READY=1")
        while not stop.wait(TICK_S):
            if not server.serves:
                raise RuntimeError("the page's server has ended")
            if server.moves and all(watch.moves for watch in watches):
                notify("WATCHDOG=1")
        for each in kept:
            each.stop()


def _live_maps(addresses: list[LineAddress], maps: FieldMaps) -> list[LiveMap]:
    """One for each line with a GNSS receiver whose run may be kept on this machine."""
    configs = [address.loaded() for address in addresses if address.config]
    if not any(config.gnss for config in configs):
        return []
    from tuberline.maps.live import LiveMap

    return [
        LiveMap(config, partial(maps.put_cells, config.name), partial(maps.tell_why, config.name))
        for config in configs
        if config.gnss
    ]


def _token(file: Path | None) -> str:
    """The token of `file`, or a new one where a person sees it: a journal keeps no secrets. '' elsewhere.

    The null device is none, too: containers mount it where no one is to act.

    Raises:
        ConfigError: the file cannot be read, is empty, or holds what is no token.
    """
    if file is None:
        return secrets.token_urlsafe(12) if sys.stdout.isatty() else ""
    token = read_text(file, what="--token-file", error=ConfigError).strip()
    if not token:
        if file.is_char_device():
            return ""
        raise ConfigError(
            f"--token-file {file} is empty: write a token of 16 to 256 ASCII characters into it, as python3 -c 'import "
            "secrets; print(secrets.token_urlsafe())' makes one, or give --token-file /dev/null for a page that only "
            "looks"
        )
    if not 16 <= len(token) <= 256 or not token.isascii():
        raise ConfigError(f"--token-file {file} holds {len(token)} characters; give 16 to 256 ASCII ones")
    return token
