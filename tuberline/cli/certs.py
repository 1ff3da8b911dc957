"""`tuberline certs`: a private authority and one certificate per node."""

from __future__ import annotations

import json as json_module
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App

from conveyor.access import line_identities
from conveyor.config import LineConfig, load_config
from conveyor.errors import ConfigError, InputError
from conveyor.identity import CA_FILE, Identity
from tuberline.cli.numbers import within

if TYPE_CHECKING:
    from tuberline.certs import CertificateInfo

Days = Annotated[int, within(1, 3650, "days")]

certs = App(name="certs", help="A site's own certificates: make them, add one, show when they expire.")


@certs.command
def make(
    config: Path, *, out: Path | None = None, host: tuple[str, ...] = (), days: Days = 730, renew: bool = False
) -> None:
    """Make what a line lacks: an authority, the router's certificate and one for every node that may connect.

    Parameters
    ----------
    config
        The line's TOML file.
    out
        Folder of the certificates; default: link.certs of that file. Make it on one machine, keep ca.key there.
    host
        Further names or addresses of the router, beside those in the file; may be given more than once.
    days
        How long the nodes' certificates are valid.
    renew
        Replace certificates that are there already (never the authority); the router's keeps the names that it had.
    """
    from tuberline.certs import issue, make_authority

    line = load_config(config)
    folder = _folder(line, out)
    former = _former_hosts(folder)
    if former and not renew and (new := [name for name in host if name.strip("[]") not in former]):
        options = " ".join(f"--host {name}" for name in new)
        raise InputError(
            f"{options}: the router's certificate in {folder} is there, and for {', '.join(former)} alone; `tuberline "
            f"certs add router {config} --renew {options}` makes it again"
        )
    made = [] if (folder / CA_FILE).exists() else [make_authority(folder, site=line.name)]
    for identity in (Identity("router"), *line_identities(line)):
        if renew or not (folder / f"{identity.stem}.pem").exists():
            hosts = router_hosts(line, (*host, *former)) if identity.role == "router" else ()
            made.append(issue(folder, identity, line=line.name, hosts=hosts, days=days, renew=renew))
    _print(made, json=False)
    sys.stdout.write(
        f"{len(made)} made in {folder}. Each node needs {CA_FILE} and its own .pem and .key, nothing else; "
        "ca.key stays here.\n"
    )


@certs.command
def add(
    node: str,
    config: Path,
    *,
    out: Path | None = None,
    host: tuple[str, ...] = (),
    days: Days = 730,
    renew: bool = False,
) -> None:
    """Make the certificate of one more node, e.g. regressor/barn or viewer/office.

    Parameters
    ----------
    node
        ROLE/NAME, or ROLE alone for a certificate that all of a role share.
    config
        The line's TOML file.
    out
        Folder of the certificates; default: link.certs of that file.
    host
        Of the router: further names or addresses, as for `certs make`.
    days
        How long it is valid.
    renew
        Replace one that is there already; the router's keeps the names that it had.
    """
    from tuberline.certs import issue

    line = load_config(config)
    identity = Identity.parse(node)
    if host and identity.role != "router":
        raise InputError(f"--host {host[0]}: nodes call the router alone by a name; {node} needs none")
    folder = _folder(line, out)
    hosts = router_hosts(line, (*host, *_former_hosts(folder))) if identity.role == "router" else ()
    _print([issue(folder, identity, line=line.name, hosts=hosts, days=days, renew=renew)], json=False)
    if identity.role != "router" and identity not in line_identities(line):
        sys.stderr.write(
            f"{node} is not among those that [access] of {config} lets in: add it there and restart the router\n"
        )


@certs.command
def show(path: Path, /, *, json: bool = False) -> None:
    """Print who the certificates in a folder (or one file) are for and when they expire.

    Parameters
    ----------
    path
        A folder of certificates, or one .pem file.
    json
        For machines.
    """
    from tuberline.certs import read_certificate

    files = sorted(path.glob("*.pem")) if path.is_dir() else [path]
    if not files:
        raise ConfigError(f"no certificates (*.pem) in {path}")
    _print([read_certificate(file) for file in files], json=json)


def router_hosts(config: LineConfig, extra: tuple[str, ...]) -> list[str]:
    """Names and addresses the router of this line is reached at."""
    endpoints = (config.link.router, *config.link.listen)
    found = [endpoint.split("/", 1)[1].split("#")[0].split("?")[0].rsplit(":", 1)[0] for endpoint in endpoints]
    reachable = [host.strip("[]") for host in found if host not in ("0.0.0.0", "[::]")]
    return list(dict.fromkeys((*reachable, *extra, "localhost", "127.0.0.1")))


def _former_hosts(folder: Path) -> tuple[str, ...]:
    """What the router's certificate that is there is for; empty where none is that can be read."""
    from tuberline.certs import read_certificate

    try:
        return read_certificate(folder / f"{Identity('router').stem}.pem").hosts
    except InputError:
        return ()


def _folder(config: LineConfig, out: Path | None) -> Path:
    folder = out or config.link.certs
    if folder is None:
        raise ConfigError("give --out FOLDER, or set link.certs in the line's TOML file")
    return folder


def _print(infos: list[CertificateInfo], *, json: bool) -> None:
    from tuberline.certs import LATE_DAYS

    now = datetime.now(UTC)
    if json:
        report = [
            {
                "file": str(info.path),
                "common_name": info.common_name,
                "issuer": info.issuer,
                "not_before": info.not_before.isoformat(),
                "not_after": info.not_after.isoformat(),
                "days_left": round(info.days_left(now), 1),
                "hosts": list(info.hosts),
                "authority": info.authority,
            }
            for info in infos
        ]
        sys.stdout.write(json_module.dumps(report, indent=2) + "\n")
        return
    if not infos:
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table("file", "name", "expires", "days left", "hosts")
    for column in table.columns:
        column.overflow = "fold"  # no name is cut
    for info in infos:
        left = info.days_left(now)
        colour = "red" if left < 0 else "yellow" if left < LATE_DAYS else "green"
        table.add_row(
            escape(info.path.name),
            escape(info.common_name),
            info.not_after.strftime("%Y-%m-%d"),
            f"[{colour}]{left:.0f}[/]",
            escape(", ".join(info.hosts)),
        )
    Console().print(table)
