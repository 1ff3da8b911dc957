"""`tuberline doctor`, `tuberline health`, `tuberline bundle`: what is wrong, is it well, and what to send for help."""

from __future__ import annotations

import json as json_module
import sys
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from conveyor import __version__
from conveyor.config import LineConfig, load_config
from conveyor.doctor import Finding, Level, worst
from conveyor.doctor.finding import fault, ok
from conveyor.errors import InputError, LinkError, TuberlineError
from conveyor.messages import Counters

LISTEN_S = 2.5


def doctor(*, config: Path, json: bool = False, offline: bool = False) -> None:
    """Look for what is wrong with a line and this machine; each finding comes with its mend. Exits with 1 on a fault.

    Parameters
    ----------
    config
        The line's TOML file.
    json
        For machines.
    offline
        Leave out what needs the running line.
    """
    findings = examine(load_config(config), offline=offline)
    if json:
        report = {"worst": worst(findings).value, "findings": [asdict(finding) for finding in findings]}
        sys.stdout.write(json_module.dumps(report, indent=2) + "\n")
    else:
        _print(findings)
    if worst(findings) is Level.FAULT:
        sys.exit(1)


def health(
    *, config: Path | None = None, connect: str | None = None, node: str | None = None, timeout_s: float = 5.0
) -> None:
    """Say whether the router answers and, if named, one node is alive and makes progress; exit code 2 if not.

    Parameters
    ----------
    config
        The line's TOML file.
    connect
        Endpoint of its router; instead of a config.
    node
        ROLE/NAME, e.g. camera/front.
    timeout_s
        How long to look for it.
    """
    from conveyor.cli.status import line_address
    from conveyor.observer import Observer

    link, line = line_address(config, connect, None)
    with Observer(link.model_copy(update={"connect_timeout_s": timeout_s}), line=line) as observer:
        if node is None:
            sys.stdout.write(f"router at {link.router} answers\n")
            return
        deadline = time.monotonic() + timeout_s
        while not (node in observer.alive() and node in observer.nodes()):
            if time.monotonic() > deadline:
                known = ", ".join(sorted(observer.alive())) or "none"
                raise LinkError(f"{node} of line '{line}' is not alive; alive: {known}")
            time.sleep(0.05)
        counters = observer.nodes()[node]
    if counters.status != "ok":
        raise LinkError(f"{node} is {counters.status} after {counters.uptime_s:.0f} s (pid {counters.pid})")
    sys.stdout.write(f"{node} is well: up {counters.uptime_s:.0f} s\n")


def bundle(*, config: Path, out: Path | None = None) -> None:
    """Pack what a helper needs to see into one archive: config, logs, summary, versions, counters. No private keys.

    Parameters
    ----------
    config
        The line's TOML file.
    out
        The archive; default: tuberline-<line>-<time>.tar.gz here.
    """
    from conveyor.doctor.bundle import write_bundle

    line = load_config(config)
    live = look(line)
    findings = examine(line, live=live)
    path = out or Path(f"tuberline-{line.name}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.tar.gz")
    members = write_bundle(
        path,
        line,
        reports={
            "doctor.json": [asdict(finding) for finding in findings],
            "counters.json": {name: asdict(counters) for name, counters in sorted(live.nodes.items())},
            "totals.json": live.totals,
            "alive.json": sorted(live.alive),
        },
    )
    sys.stdout.write(f"{path}: {len(members)} files, {path.stat().st_size / 1e6:.2f} MB, no private keys\n")


@dataclass(slots=True)
class Live:
    """What was heard of the running line; `unreachable` says why nothing was."""

    nodes: dict[str, Counters] = field(default_factory=dict)
    alive: set[str] = field(default_factory=set)
    clocks_s: dict[str, float] = field(default_factory=dict)
    totals: dict[str, Any] | None = None
    unreachable: str = ""


def look(config: LineConfig, *, listen_s: float = LISTEN_S) -> Live:
    """Listen to the line for a moment."""
    from conveyor.doctor.line import ClockWatch
    from conveyor.observer import Observer

    link = config.link.model_copy(update={"connect_timeout_s": 3.0})
    try:
        with Observer(link, line=config.name) as observer:
            clocks = ClockWatch(observer)
            time.sleep(listen_s)
            totals = observer.totals()
            return Live(
                nodes=observer.nodes(),
                alive=observer.alive(),
                clocks_s=clocks.offsets_s(),
                totals=asdict(totals) if totals else None,
            )
    except TuberlineError as error:
        return Live(unreachable=str(error))


def examine(config: LineConfig, *, offline: bool = False, live: Live | None = None) -> list[Finding]:
    """All findings, the machine's first."""
    from conveyor.doctor import link, machine

    findings = machine.check_disk(config.aggregator.out, what="the ledger")
    if config.segmenter.state_dir:
        findings += machine.check_disk(config.segmenter.state_dir, what="the camera log")
    findings += machine.check_processors(config) + machine.check_locked_memory() + machine.check_usb(config)
    findings += link.check_certificates(config, now=datetime.now(UTC))
    findings += _weights(config)
    heard = Live() if offline else live or look(config)
    findings += _cameras(config, alive=heard.alive)
    if not offline:
        findings += link.check_port(config.link) + _running(config, heard)
    return findings


def _running(config: LineConfig, live: Live) -> list[Finding]:
    from conveyor.doctor.line import check_clocks, check_nodes, check_versions

    if live.unreachable:
        return [fault("line", live.unreachable, "see the findings on the router's port and the certificates")]
    if not live.alive and not live.nodes:
        return [
            fault(
                "nodes", f"nobody of line '{config.name}' is there", "start it: `tuberline run` or its systemd target"
            )
        ]
    return [
        *check_nodes(config, live.nodes, alive=live.alive),
        *check_versions({name: c for name, c in live.nodes.items() if name in live.alive}, own=__version__),
        *check_clocks({name: s for name, s in live.clocks_s.items() if name in live.alive}, live.nodes),
    ]


def _weights(config: LineConfig) -> list[Finding]:
    def load() -> str:
        from regressor.weigher import Weigher

        weigher = Weigher.load(config.regressor.weights)
        return f"{config.regressor.weights or 'the shipped ones'}: {weigher.sidecar.model_id}"

    return [_tried("weights", load, "set regressor.weights to a .safetensors or .pth that `tuberline evaluate` takes")]


def _cameras(config: LineConfig, *, alive: set[str]) -> list[Finding]:
    def look_through(name: str) -> str:
        from camera_sim.configured import configured_source
        from camera_sim.sources import Refused

        source = configured_source(config, name)
        frames: Any = source.frames(run="doctor")
        with closing(frames):  # a device is let go again
            first = next(frames, None)
        if first is None or isinstance(first, Refused):
            raise InputError(f"{source.description.origin} gives no frame" + (f": {first.text}" if first else ""))
        return f"{first.depth.shape[1]}x{first.depth.shape[0]} from {source.description.origin}"

    found = []
    for name, camera in sorted(config.cameras.items()):
        check = f"camera {name}"
        if camera.source == "realsense" and f"camera/{name}" in alive:
            found.append(ok(check, "in use by its node, not touched"))
        else:
            mend = f"mend [cameras.{name}] in the config, or the recording or device it names"
            found.append(_tried(check, partial(look_through, name), mend))
    return found


def _tried(check: str, work: Callable[[], str], mend: str) -> Finding:
    try:
        return ok(check, work())
    except TuberlineError as error:
        return fault(check, str(error), mend)


def _print(findings: list[Finding]) -> None:
    from rich.console import Console
    from rich.markup import escape

    colours = {Level.OK: "green", Level.WARNING: "yellow", Level.FAULT: "red"}
    console = Console(soft_wrap=True, highlight=False)
    for finding in findings:
        mark = f"[{colours[finding.level]}]{finding.level.value:8}[/]"
        console.print(f"{mark}[bold]{escape(finding.check)}[/]: {escape(finding.text)}")
        if finding.mend:
            console.print(f"        mend: {escape(finding.mend)}")
