"""`tuberline config`: check, show, schema."""

from __future__ import annotations

import json as json_module
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from cyclopts import App

from conveyor.config import LineConfig, dump_toml, load_config
from conveyor.config_camera import at_one_place, hang_together
from conveyor.endpoints import host_and_port
from conveyor.errors import InputError
from conveyor.formats.detect import camera_names
from conveyor.session import link_fault
from tuberline.cli.named_files import check_access, unreadable_files

config = App(name="config", help="Check, show or explain a line's configuration.")


@config.command
def check(config: Path) -> None:
    """Say whether a line's TOML file is accepted; every fault is named.

    Warned of is what may lie on another computer of the line: recordings, weights, tickets, contracts and channels
    of alarms that cannot be read here. So are a line without a camera, cameras without a recording or topic, or not
    in their recording, live cameras that hang at one place, an encoder that no camera hears, folders for the ledger
    and for state that cannot be made, a link that contradicts itself, and a folder of certificates that is not
    here. The last line says how many warnings there are; they do not change the exit code.

    Parameters
    ----------
    config
        The line's TOML file.

    Raises
    ------
    ConfigError
        It is not accepted; or no router would take it, for access control needs TLS.
    """
    line = load_config(config)
    check_access(line, config)
    warnings = list(_warnings(line))
    for warning in warnings:
        sys.stderr.write(f"warning: {warning}\n")
    cameras = ", ".join(sorted(line.cameras)) or "none"
    count = f"{len(warnings)} warning{'s' if len(warnings) > 1 else ''}"
    verdict = f"is accepted, with {count}" if warnings else "is fine"
    sys.stdout.write(f"{config} {verdict}: line '{line.name}', cameras {cameras}\n")


def _warnings(line: LineConfig) -> Iterator[str]:
    if not line.cameras:
        yield "no camera is named: `tuberline run` and the aggregator refuse that; a router and regressors need none"
    for name, camera in sorted(line.cameras.items()):
        if camera.path is not None and not os.path.exists(
            camera.path
        ):  # a folder that may not be entered raises nothing
            yield f"cameras.{name}.path: {camera.path} is not on this computer"
        if camera.path is None and camera.source == "recording":
            yield f"cameras.{name} has no path: a camera that replays a recording cannot start"
        if camera.source == "ros2" and camera.topic is None:
            yield f"cameras.{name} has no topic: a ros2 camera cannot start"
    yield from _places(line)
    yield from _link(line)
    if together := at_one_place(line.cameras):
        yield hang_together(together)
    if line.encoder is not None and not line.hears_encoder:
        yield "encoder: no camera of this line is live, and recordings bring their own travel"
    yield from unreadable_files(line)
    yield from _recordings(line)


def _places(line: LineConfig) -> Iterator[str]:
    """Folders of results and of state that cannot be made."""
    if os.path.exists(out := line.aggregator.out) and not os.path.isdir(out):
        yield f"aggregator.out: {out} is no folder on this computer: the ledger needs one of its own"
    folders = {"aggregator.out": out.parent, "segmenter.state_dir": line.segmenter.state_dir}
    folders["regressor.state_dir"] = line.regressor.state_dir
    for key, folder in folders.items():
        file = next((place for place in (folder, *folder.parents) if os.path.isfile(place)), None) if folder else None
        if file and not (key == "segmenter.state_dir" and file in (out, *out.parents)):
            yield f"{key}: {file} is a file on this computer: no folder can be made there"


def _recordings(line: LineConfig) -> Iterator[str]:
    """Files that cameras name and that hold no recording; a folder may be filled later."""
    for name, camera in sorted(line.cameras.items()):
        if camera.path is not None and os.path.isfile(camera.path):
            try:
                camera_names(camera.path)
            except InputError as error:
                yield f"cameras.{name}.path: {error}"


def _link(line: LineConfig) -> Iterator[str]:
    """What of the link would keep processes from their router."""
    if fault := link_fault(line.link):
        yield fault
    elif line.link.certs and not os.path.isdir(line.link.certs):
        yield f"link.certs: there is no folder {line.link.certs} on this computer"
    port = host_and_port(line.link.router)[1]
    listened = [host_and_port(endpoint)[1] or endpoint for endpoint in line.link.listen]
    if port.isdecimal() and listened and port not in listened:
        yield (
            f"link.listen: the router listens on port {', '.join(listened)}, and link.router names port {port}: no "
            "process reaches it unless something forwards that port"
        )


@config.command
def show(config: Path | None = None, *, json: bool = False, explain: str | None = None) -> None:
    """Print the effective configuration: the file's settings and every default.

    Parameters
    ----------
    config
        The line's TOML file; without it the defaults alone.
    json
        JSON instead of TOML.
    explain
        One key alone, e.g. segmenter.ring: its type, default, range, unit, meaning and an example.
    """
    line = load_config(config) if config else LineConfig()
    if explain is not None:
        from dataclasses import asdict

        from tuberline.cli.config_page import explained

        row = asdict(explained(explain))
        words = "".join(f"{name:<8} {value.replace('`', '')}\n" for name, value in row.items() if value)
        sys.stdout.write(json_module.dumps(row, indent=2) + "\n" if json else words)
        return
    sys.stdout.write(line.model_dump_json(indent=2) + "\n" if json else dump_toml(line))


@config.command
def schema() -> None:
    """Print the JSON schema of the configuration, for editors."""
    sys.stdout.write(json_module.dumps(LineConfig.model_json_schema(), indent=2) + "\n")
