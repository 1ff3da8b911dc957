"""What a line that is installed here would share with one that is here already, where one of the two would not work.

    clash.py ROOT UNITS CERTS FILES < CONFIGS

ROOT is where /etc is, UNITS are those of the new line, CERTS the folder that its FILES come from, CONFIGS what
`tuberline config show --json` says of the new line and then of each other. The first fault is told, and ends it with 2.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

WILD = ("0.0.0.0", "[::]", "*")
LISTENING = {"metrics": ("TUBERLINE_METRICS", "127.0.0.1:9108"), "page": ("TUBERLINE_PAGE", "127.0.0.1:9180")}
WRITING = (("aggregator", "aggregator", "out"), ("gnss", "aggregator", "out"), ("regressor", "regressor", "state_dir"))
"""Role, and the section and key of the folder that it writes to."""


class Line:
    """A line of this host: its config, and the roles that run here."""

    def __init__(self, root: Path, config: dict[str, Any], units: str) -> None:
        self.name, self.config = config["name"], config
        self.roles = set(re.findall(r"tuberline-(\w+)@", units))
        self._root, self._etc = root, root / "etc/tuberline"

    def listens(self, role: str) -> set[str]:
        """HOST:PORT of what a role listens on."""
        if role == "router":
            link = self.config["link"]
            return {each.partition("/")[2].partition("#")[0] for each in link["listen"] or [link["router"]]}
        variable, at = LISTENING[role]
        for file in (self._etc / "environment", self._etc / f"lines/{self.name}.environment"):
            said = re.findall(rf"^{variable}=(.*)$", file.read_text(), re.MULTILINE) if file.is_file() else []
            at = said[-1].strip("\"' ") if said else at
        return {at}

    def serial_ports(self) -> dict[Path, tuple[str, str]]:
        """The role that reads a serial port here and the port as the config names it, by the port itself."""
        found = {}
        for role in ("encoder", "gnss"):
            source = urlsplit((self.config.get(role) or {}).get("source", ""))
            if role in self.roles and source.scheme == "serial":
                port = (self._root / source.path.lstrip("/")).resolve()  # /dev/serial/by-id/... is a link
                found[port] = (role, source.path)
        return found


def meet(one: str, other: str) -> bool:
    """Whether two addresses cannot be listened on at once."""
    (host, _, port), (host2, _, port2) = one.rpartition(":"), other.rpartition(":")
    return port == port2 and (host == host2 or host in WILD or host2 in WILD)


def another(role: str, new: Line, old: Line) -> str:
    """How to give a role another place, in words."""
    if role == "router":
        return "give it another port in link.router and link.listen, or leave router out of --roles and use that one"
    how = f"write {LISTENING[role][0]}=HOST:PORT into /etc/tuberline/lines/{new.name}.environment"
    both = f"tuberline-page@{old.name}:{new.name}.service"
    return how if role == "metrics" else f"{how}, or leave page out of --roles and let {both} show both"


def fault(new: Line, old: Line, *, certs: dict[Path, Path]) -> str:
    """What the two would share, in words; '' where they can run beside each other.

    certs: where each certificate of the new line comes from, by where it goes.
    """
    both = new.roles & old.roles
    for role in sorted(both & {"router", *LISTENING}):
        for at in sorted(new.listens(role)):
            if any(meet(at, there) for there in old.listens(role)):
                return (
                    f"the {role} of line '{new.name}' would listen on {at}, which that of line '{old.name}' takes: "
                    f"{another(role, new, old)}"
                )
    for role, section, key in WRITING:
        folder = new.config[section][key]
        if role in both and folder is not None and folder == old.config[section][key]:
            return (
                f"{section}.{key} of line '{new.name}' is {folder}, as that of line '{old.name}' is: each needs its "
                f"own, such as /var/lib/tuberline/{new.name}/{Path(folder).name}"
            )
    taken = old.serial_ports()
    for port, (role, said) in new.serial_ports().items():
        if port in taken:
            return (
                f"the {role} of line '{new.name}' would read {said}, which the {taken[port][0]} of line '{old.name}' "
                f"reads: name a port of its own in {role}.source, or leave {role} out of --roles"
            )
    if new.config["link"]["certs"] == old.config["link"]["certs"]:
        for there, given in certs.items():
            if there.is_file() and there.read_bytes() != given.read_bytes():
                return (
                    f"{given} would replace {there}, which line '{old.name}' uses: name a folder of its own in "
                    f"link.certs of line '{new.name}', such as /etc/tuberline/certs/{new.name}"
                )
    return ""


def main() -> None:
    """Compare the first config with each other."""
    root, units, given, files = Path(sys.argv[1] or "/"), sys.argv[2], Path(sys.argv[3]), sys.argv[4].split()
    text, configs = sys.stdin.read().strip(), []
    while text:
        config, end = json.JSONDecoder().raw_decode(text)
        configs.append(config)
        text = text[end:].strip()
    folder = root / (configs[0]["link"]["certs"] or "/etc/tuberline/certs").lstrip("/")
    new = Line(root, configs[0], units)
    for config in configs[1:]:
        nodes = root / f"etc/systemd/system/tuberline@{config['name']}.target.d/nodes.conf"
        old = Line(root, config, nodes.read_text() if nodes.is_file() else "")
        said = fault(new, old, certs={folder / name: given / name for name in files})
        if said:
            sys.stderr.write(f"install.sh: {said}\n")
            sys.exit(2)


if __name__ == "__main__":
    main()
