"""The router's configuration as a file, for zenohd or to look at: what `tuberline router` uses, written down."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from conveyor.access import router_access
from conveyor.config import LineConfig
from conveyor.errors import ConfigError
from conveyor.identity import CA_FILE
from conveyor.session import ENCRYPTED, router_settings


def router_file(config: LineConfig, *, certs: Path | None = None, zenohd: bool = True) -> dict[str, Any]:
    """Zenoh settings of the line's router.

    Args:
        config: the line.
        certs: folder of the certificates on the machine where the router will run, which need not exist here; default:
            those of the line's link.
        zenohd: for the zenohd daemon: without plugins and without storages (the aggregator keeps what must be kept).

    Raises:
        ConfigError: `certs` given for a line whose link is not encrypted.
    """
    endpoints = (config.link.router, *config.link.listen)
    if certs is not None and not any(endpoint.startswith(ENCRYPTED) for endpoint in endpoints):
        raise ConfigError(f"certificates were given but the line's link is {config.link.router}: make it tls/HOST:PORT")
    files = (certs / CA_FILE, certs / "router.pem", certs / "router.key") if certs is not None else None
    settings = router_settings(config.link, access_control=router_access(config), files=files)
    if zenohd:
        settings["metadata"] = {"name": "zenohd", "line": config.name}
        settings["plugins_loading"] = {"enabled": False}
    return settings


def settings_text(settings: dict[str, Any]) -> str:
    """Settings as JSON (and so JSON5) that a person can read and compare: one access rule a line."""
    access = settings.get("access_control")
    if not access:
        return json.dumps(settings, indent=2) + "\n"
    lists = {name: value for name, value in access.items() if isinstance(value, list)}
    marked = {name: f"@{name}@" if name in lists else value for name, value in access.items()}
    text = json.dumps({**settings, "access_control": marked}, indent=2)
    for name, items in lists.items():
        lines = ",\n".join(f"      {json.dumps(item)}" for item in items)
        text = text.replace(f'"@{name}@"', f"[\n{lines}\n    ]" if items else "[]")
    return text + "\n"
