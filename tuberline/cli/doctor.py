"""`tuberline doctor` and `tuberline bundle`: what is wrong, and what to send for help."""

from __future__ import annotations

import json as json_module
import sys
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from tuberline.cli.address import LineAddress
from tuberline.cli.progress import work_bar
from tuberline.doctor import Finding, Level, worst
from tuberline.doctor.examine import examine, look


def doctor(
    config: Path,
    *,
    connect: str | None = None,
    line: str | None = None,
    json: bool = False,
    offline: bool = False,
) -> None:
    """Look for what is wrong with a line and this machine; each finding says how to fix it. Exits with 1 on a fault.

    Parameters
    ----------
    config
        The line's TOML file.
    connect
        Endpoint of its router, instead of the one that the file names.
    line
        Name of the line, instead of the one in the file.
    json
        For machines.
    offline
        Leave out what needs the running line.
    """
    watched = LineAddress(config, connect, line).watched()
    with work_bar("looking") as on_work:
        findings = examine(watched, offline=offline, on_work=on_work)
    if json:
        report = {"worst": worst(findings).value, "findings": [asdict(finding) for finding in findings]}
        sys.stdout.write(json_module.dumps(report, indent=2) + "\n")
    else:
        _print(findings)
    if worst(findings) is Level.FAULT:
        sys.exit(1)


def bundle(config: Path, *, connect: str | None = None, line: str | None = None, out: Path | None = None) -> None:
    """Pack what a helper needs to see into one archive: config, logs, summary, versions, counters. No private keys.

    Parameters
    ----------
    config
        The line's TOML file.
    connect
        Endpoint of its router, instead of the one that the file names.
    line
        Name of the line, instead of the one in the file.
    out
        The archive; default: tuberline-<line>-<time>.tar.gz here.
    """
    from tuberline.doctor.bundle import write_bundle

    watched = LineAddress(config, connect, line).watched()
    with work_bar("looking") as on_work:
        live = look(watched)
        findings = examine(watched, live=live, on_work=on_work)
    path = out or Path(f"tuberline-{watched.name}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.tar.gz")
    members = write_bundle(
        path,
        watched,
        reports={
            "doctor.json": [asdict(finding) for finding in findings],
            "counters.json": {name: asdict(counters) for name, counters in sorted(live.nodes.items())},
            "totals.json": live.totals,
            "alive.json": sorted(live.alive),
        },
    )
    sys.stdout.write(f"{path}: {len(members)} files, {path.stat().st_size / 1e6:.2f} MB, no private keys\n")


def _print(findings: list[Finding]) -> None:
    from rich.console import Console
    from rich.markup import escape

    colours = {Level.OK: "green", Level.WARNING: "yellow", Level.FAULT: "red"}
    console = Console(soft_wrap=True, highlight=False)
    for finding in findings:
        mark = f"[{colours[finding.level]}]{finding.level.value:8}[/]"
        console.print(f"{mark}[bold]{escape(finding.check)}[/]: {escape(finding.text)}")
        if finding.fix:
            console.print(f"        fix: {escape(finding.fix)}")
