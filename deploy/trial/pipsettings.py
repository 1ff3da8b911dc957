"""pip's settings on this machine, for a build in a root of its own: nothing of them stays in what is built."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from deploy.trial.tools import run

NOT_FOR_BUILDS = ("config-file", "user", "target", "prefix", "root", "require-virtualenv")


def settings() -> dict[str, list[str]]:
    """Every option of `pip config list`, from files and PIP_* variables; words in the order of precedence."""
    found: dict[str, list[str]] = {}
    listed = run([sys.executable, "-m", "pip", "config", "list"], check=False).stdout
    for line in listed.splitlines():
        match = re.fullmatch(r"(?::env:|global|user|site|install)\.([\w-]+)='(.*)'", line.replace("\\n", " "))
        if match and match[1] not in NOT_FOR_BUILDS:
            words = found.setdefault(match[1], [])
            words += [word for word in match[2].split() if word not in words]
    return found


def write_settings(file: Path) -> list[Path]:
    """Write them as one pip.conf; returns the folders and files of this machine that they name, to be mounted."""
    single = {"cert", "timeout", "default-timeout", "index-url", "disable-pip-version-check", "trusted-host"}
    lines, paths = ["[global]"], []
    for option, words in settings().items():
        lines.append(f"{option} = {words[0] if option in single else ' '.join(words)}")
        for word in words:
            path = Path(word.removeprefix("file://"))
            if path.is_absolute() and path.exists():
                # A local index refers to files beside its own folder.
                paths.append(path.parent if word.startswith("file://") else path)
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return sorted(set(paths))
