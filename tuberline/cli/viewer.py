"""`tuberline viewer` and `tuberline watch`."""

from __future__ import annotations

import logging
import os
import socket
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from conveyor.config import LineConfig, ViewerConfig, load_config
from conveyor.errors import ConfigError
from conveyor.identity import names_there
from tuberline.cli.address import LineAddress
from tuberline.cli.numbers import within
from viewer.scene.profiles import PROFILES, ProfileName

if TYPE_CHECKING:
    from viewer.scene.field_scene import NewCells
    from viewer.sink import Sink

DEFAULT_LIMIT_MB = 2048
Port = Annotated[int, within(0, 65535)]


def viewer(
    *,
    config: Path,
    run: str | None = None,
    name: str = "viewer",
    rrd: Path | None = None,
    connect: str | None = None,
    profile: ProfileName | None = None,
    serve: bool = False,
    foxglove: str | None = None,
    hub_port: Port = 9876,
    page_port: Port = 9090,
    rrd_limit_mb: Annotated[int, within(0, 1_000_000, "MB")] = DEFAULT_LIMIT_MB,
) -> None:
    """Show a line in Rerun or Foxglove until stopped: in a file, in a running viewer, on a web page, in the app.

    Parameters
    ----------
    config
        The line's TOML file; options given here override its [viewer] section.
    run
        Show this run alone; default: follow the line from run to run.
    name
        Name of this node; two viewers of a line need two.
    rrd
        File to write; open it with `rerun FILE`. A later run goes to a second file beside it.
    connect
        A running Rerun viewer or hub: rerun+http://HOST:9876/proxy.
    profile
        light: numbers only, no pictures; remote: small pictures, 5 a second; full: everything.
    serve
        Start a hub with its web page on this machine and show the line there.
    foxglove
        HOST:PORT at which Foxglove's app finds the line, e.g. 127.0.0.1:8765; the app opens ws://HOST:PORT.
    hub_port
        Port of the served data (Rerun's hub).
    page_port
        Port of the served page.
    rrd_limit_mb
        No more pictures go into the file beyond this size; 0: none.
    """
    from viewer.node import Target, run_viewer

    line = load_config(config)
    section = line.viewer or ViewerConfig.model_validate({})
    chosen = profile or section.profile
    if serve and connect is not None:
        raise ConfigError("--serve starts a hub of its own and --connect names another one: give one of them")
    target = Target(
        rrd=rrd or section.rrd,
        rrd_limit_bytes=rrd_limit_mb << 20,
        connect=connect or (None if serve else section.connect),
        foxglove=foxglove or section.foxglove,
    )
    cells = _live_cells(line)
    if not serve:
        _end(run_viewer(line, target, profile=PROFILES[chosen], name=name, run=run, cells=cells))
        return
    from viewer.rerun.launch import Ports, RerunProgram

    ports = Ports(hub_port, page_port)
    with RerunProgram(ports, page=True):
        sys.stderr.write(f"open {ports.link}\n")
        served = replace(target, connect=ports.url)
        hanging = run_viewer(line, served, profile=PROFILES[chosen], name=name, run=run, cells=cells)
    _end(hanging)


def watch(
    connect: str | None = None,
    *,
    config: Path | None = None,
    line: str | None = None,
    profile: ProfileName = "light",
    web: bool = False,
    hub_port: Port = 0,
    page_port: Port = 0,
) -> None:
    """Watch a running line from here: opens Rerun's window, or a web page where there is no display. Changes nothing.

    Parameters
    ----------
    connect
        Endpoint of the line's router, e.g. tcp/10.0.0.1:7447.
    config
        The line's TOML file instead (with its certificates); the endpoint overrides its own.
    line
        Name of the line, where no config says it.
    profile
        light works on any link (no pictures); remote and full fetch every frame over it, which wants a LAN.
    web
        Serve the web page on this machine even where a window could open.
    hub_port
        Port of Rerun's data server (its hub) on this machine; default: a free one.
    page_port
        Port of the page; default: a free one.
    """
    if connect is None and config is None:
        raise ConfigError("watch which line? Give its router (tuberline watch tcp/HOST:7447) or --config line.toml")
    from conveyor.taken_port import free_port
    from viewer.node import Target, run_viewer
    from viewer.rerun.launch import Ports, RerunProgram

    watched = LineAddress(config, connect, line).watched()
    name = name_here(watched.link.certs)
    page = web or not _has_display()
    ports = Ports(hub_port or free_port(), page_port or free_port())
    with RerunProgram(ports, page=page) as program:
        if page:
            sys.stderr.write(f"open {ports.link}\n")
        target = Target(rrd=None, rrd_limit_bytes=0, connect=ports.url)
        hanging = run_viewer(watched, target, profile=PROFILES[profile], name=name, run=None, until=program.ended)
    _end(hanging)


def name_here(certs: Path | None) -> str:
    """As whom this machine watches: as the one viewer whose certificate is here, else under a name of its own.

    Raises:
        ConfigError: certificates are needed, and there are none of viewers or those of several.
    """
    own = f"watch-{socket.gethostname().split('.')[0][:32]}-{os.getpid()}"
    if certs is None or ((certs / "viewer.pem").is_file() and (certs / "viewer.key").is_file()):
        return own
    names = names_there(certs, "viewer")
    if len(names) == 1:
        return names[0]
    found = f"those of {', '.join(names)} are" if names else "none is"
    raise ConfigError(
        f"{certs}: {found} there; give this machine one viewer's certificate, such as viewer.office.pem with its .key "
        "(`tuberline certs add viewer/office`), or viewer.pem, which all viewers share where [access] lets all in"
    )


def _live_cells(line: LineConfig) -> NewCells | None:
    """Where the map of the run is put that is kept on this machine; None for a line without a GNSS receiver."""
    if line.gnss is None:
        return None
    from tuberline.maps.live import LiveMap
    from viewer.scene.field_scene import NewCells

    cells = NewCells()
    LiveMap(line, cells.put).start()
    return cells


def _has_display() -> bool:
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _end(hanging: list[Sink]) -> None:
    """Leave without destructors and exit handlers when a hub hangs: they would wait for it forever."""
    if hanging:
        logging.shutdown()
        os._exit(0)
