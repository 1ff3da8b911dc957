"""Folders and files of a line's config that its units could not use.

    paths.py ROOT BESIDE UNITS < CONFIG

ROOT is where /etc is, CONFIG what `tuberline config show --json` says of a copy of the line's file in the folder
BESIDE, where nothing else lies, and UNITS are those of the line on this host. The first fault is told, and ends it
with 2.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

STATE = "/var/lib/tuberline"
"""What systemd lets every unit write (StateDirectory=); the rest of the system is read-only to them."""
WRITING = (
    ("aggregator", "aggregator", "out"),
    ("gnss", "aggregator", "out"),
    ("segmenter", "segmenter", "state_dir"),
    ("regressor", "regressor", "state_dir"),
    ("alarms", "alarms", "state_dir"),
)
"""Role, and the section and key of the folder that it writes to."""
USUAL = {
    "aggregator.out": f"{STATE}/{{}}/ledger",
    "segmenter.state_dir": f"{STATE}/{{}}/state",
    "regressor.state_dir": f"{STATE}/{{}}/weights",
    "link.certs": "/etc/tuberline/certs",
}
"""Where these are in the examples, for a line."""


def values(section: dict[str, Any], name: str = "") -> Iterator[tuple[str, str]]:
    """(key with its sections, text) of every text in a config."""
    for key, value in section.items():
        if isinstance(value, dict):
            yield from values(value, f"{name}{key}.")
        elif isinstance(value, str):
            yield f"{name}{key}", value


def fault(config: dict[str, Any], *, beside: str, roles: set[str], allowed: set[str]) -> str:
    """The first path that is relative, or that a unit of these roles may not write; '' where there is none."""
    line = config["name"]
    relative = {key: said.removeprefix(f"{beside}/") for key, said in values(config) if said.startswith(f"{beside}/")}
    for key in (*USUAL, *relative):
        if key in relative:
            such_as = f", such as {USUAL[key].format(line)}" if key in USUAL else ""
            return (
                f"{key} of line '{line}' is {relative[key]}, beside a file that is copied to /etc/tuberline/lines: "
                f"name it from / on{such_as}"
            )
    for role, section, key in WRITING:
        folder = (config[section] or {}).get(key) if role in roles else None
        if folder and not any(PurePosixPath(folder).is_relative_to(each) for each in allowed):
            return (
                f"{section}.{key} of line '{line}' is {folder}, where no unit may write: name a folder in {STATE}, or "
                f"give tuberline-{role}@.service a drop-in with ReadWritePaths={folder}"
            )
    return ""


def main() -> None:
    """Look at the config, and at the drop-ins that are installed."""
    root, beside, units = Path(sys.argv[1] or "/"), sys.argv[2], sys.argv[3]
    drop_ins = (root / "etc/systemd/system").glob("tuberline-*.d/*.conf")
    given = (re.findall(r"^ReadWritePaths=(.*)$", file.read_text(), re.MULTILINE) for file in drop_ins)
    allowed = {STATE} | {word.lstrip("-+") for lines in given for line in lines for word in line.split()}
    roles = set(re.findall(r"tuberline-(\w+)@", units))
    said = fault(json.load(sys.stdin), beside=beside, roles=roles, allowed=allowed)
    if said:
        sys.stderr.write(f"install.sh: {said}\n")
        sys.exit(2)


if __name__ == "__main__":
    main()
