"""Checks of the way to the router: its port, and the certificates of this machine."""

from __future__ import annotations

import socket
import stat
from datetime import datetime
from pathlib import Path

from conveyor.config import LineConfig, LinkConfig
from conveyor.endpoints import host_and_port
from conveyor.errors import TuberlineError
from tuberline.doctor.finding import Finding, Level, fault, ok, warning

EVERYWHERE = ("0.0.0.0", "::")
"""Where a router may listen, and no node calls it by."""


def router_address(link: LinkConfig) -> tuple[str, int]:
    """(host, port) of the router's endpoint, e.g. of 'tls/edge:7447'."""
    host, port = host_and_port(link.router)
    return host.strip("[]"), int(port)


def check_port(link: LinkConfig, *, timeout_s: float = 2.0) -> list[Finding]:
    """Something listens at the router's endpoint."""
    if not link.router.startswith(("tcp/", "tls/")):
        return [ok("router port", f"{link.router} is no TCP endpoint: not probed")]
    host, port = router_address(link)
    try:
        with socket.create_connection((host, port), timeout_s):
            return [ok("router port", f"{host}:{port} answers")]
    except OSError as error:
        return [
            fault(
                "router port",
                f"{host}:{port} does not answer: {error.strerror or error}",
                "start the line (`tuberline run`; until then `tuberline doctor --offline` looks at all the rest), or "
                f"the router (`tuberline router` or tuberline-router@LINE.service); open port {port} in the firewall "
                "of its host, or correct link.router",
            )
        ]


def no_router(link: LinkConfig, port: list[Finding], unreachable: str) -> list[Finding]:
    """Why no router answers, where none does: what listens at its port (`port`: findings on that) may be another
    program, or certificates do not fit."""
    if not unreachable:
        return []
    if any(finding.level is not Level.OK for finding in port) or not link.router.startswith(("tcp/", "tls/")):
        return [fault("line", unreachable, "see the findings on the router's port and the certificates")]
    number = router_address(link)[1]
    return [
        fault(
            "line",
            f"{unreachable.partition(';')[0]}, though something listens there",
            f"see which program that is (`ss -ltnp 'sport = :{number}'`): where it is another one, stop it or choose "
            "another port in link.router; where it is the router, the certificates do not fit",
        )
    ]


def check_certificates(config: LineConfig, *, now: datetime) -> list[Finding]:
    """Expiry, privacy of the keys, and that the router's certificate is for the name it is called by."""
    if config.link.certs is None and config.link.certificate is None:
        return []
    from tuberline.certs import LATE_DAYS, CertificateInfo, read_certificate

    found: list[Finding] = []
    infos: list[CertificateInfo] = []
    for path in certificate_files(config.link):
        try:
            infos.append(read_certificate(path))
        except TuberlineError as error:
            found.append(fault("certificates", str(error), "make or copy it again: `tuberline certs make`"))
    for info in infos:
        left = info.days_left(now)
        # An authority is never replaced.
        made = "--out ANOTHER_FOLDER`" if info.authority else "--renew` where ca.key is"
        renew = f"`tuberline certs make LINE.toml {made}, copy the files, restart the nodes"
        if now < info.not_before:
            found.append(
                fault("certificates", f"{info.path} is valid from {info.not_before:%Y-%m-%d} on", "set the clock")
            )
        elif left < 0:
            found.append(fault("certificates", f"{info.path} expired {-left:.0f} days ago", renew))
        elif left < LATE_DAYS:
            found.append(warning("certificates", f"{info.path} expires in {left:.0f} days", renew))
        key = info.path.with_suffix(".key")
        if key.is_file() and stat.S_IMODE(key.stat().st_mode) & 0o007:
            found.append(fault("certificates", f"{key} can be read by others", f"chmod 600 {key}"))
        called = router_address(config.link)[0]
        if info.common_name == f"router@{config.name}" and called not in info.hosts:
            fix = "`tuberline certs add router LINE.toml --renew`"
            if called in EVERYWHERE:  # no certificate is for it
                fix = f'link.listen = ["{config.link.router}"], and in link.router one of the names above in its place'
            text = f"{info.path} is for {', '.join(info.hosts)}, but nodes call {called}"
            found.append(fault("certificates", text, fix))
    if not found:
        soonest = min((info.days_left(now) for info in infos), default=0.0)
        found.append(ok("certificates", f"{len(infos)} certificates, the first expires in {soonest:.0f} days"))
    return found


def certificate_files(link: LinkConfig) -> list[Path]:
    """The certificates of this machine."""
    if link.certs is not None:
        return sorted(link.certs.glob("*.pem")) or [link.certs / "ca.pem"]
    return [path for path in (link.root_ca, link.certificate) if path]
