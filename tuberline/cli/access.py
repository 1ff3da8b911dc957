"""`tuberline access`: the router's access rules, made from the topic table."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, Literal

from conveyor.access import access_control
from conveyor.config import load_config


def access(config: Path, *, form: Literal["rules", "router", "zenohd"] = "rules", certs: Path | None = None) -> None:
    """Print who may do what on a line, as Zenoh's router takes it (JSON is JSON5).

    Parameters
    ----------
    config
        The line's TOML file.
    form
        rules: the section access_control alone. router: all settings of `tuberline router`. zenohd: the same for
        zenohd --config.
    certs
        Folder of the certificates where the router will run; default: link.certs of the file.
    """
    from tuberline.zenohd import router_file, settings_text

    line = load_config(config)
    if form == "rules":
        result: dict[str, Any] = {"access_control": access_control(line)}
    else:
        result = router_file(line, certs=certs, zenohd=form == "zenohd")
    sys.stdout.write(settings_text(result))
