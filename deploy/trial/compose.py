"""A service of a compose file as the words of `podman run`: what the file says, and nothing else."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from deploy.trial.tools import TrialError

PLAIN = {
    "mem_limit": "--memory",
    "cpus": "--cpus",
    "restart": "--restart",
}
TAKEN_ELSEWHERE = {"image", "profiles", "command", "entrypoint", "depends_on", "logging", "build", "networks"}


def services(file: Path, variables: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """The services of a compose file, its variables filled in: ${NAME}, ${NAME:-default}, ${NAME:?text}, $$.

    A service's secrets are given as their files, by name.
    """

    def value(match: re.Match[str]) -> str:
        name, default = match[1], match[2] or ""
        if name in variables:
            return variables[name]
        if default.startswith(":-"):
            return default[2:]
        raise TrialError(f"{file.name}: variable {name} is not set {default[2:]}")

    text = re.sub(r"(?<!\$)\$\{(\w+)(:[-?][^}]*)?\}", value, file.read_text(encoding="utf-8")).replace("$$", "$")
    whole = yaml.safe_load(text)
    loaded: dict[str, dict[str, Any]] = whole["services"]
    for service in loaded.values():
        if "secrets" in service:
            service["secrets"] = {name: whole["secrets"][name]["file"] for name in service["secrets"]}
    return loaded


def podman_words(service: Mapping[str, Any], *, configs: Mapping[str, Path], project: str) -> list[str]:
    """Options of `podman run` for one service; a key that is not known here is refused, so that none is left out."""
    words: list[str] = []
    for key, value in service.items():
        match key:
            case "read_only":
                words += ["--read-only", "--read-only-tmpfs=false"] if value else []
            case "init":
                words += ["--init"] if value else []
            case "cap_drop":
                words += [f"--cap-drop={name}" for name in value]
            case "security_opt":
                words += [f"--security-opt={option.removesuffix(':true')}" for option in value]
            case "tmpfs" | "devices" | "device_cgroup_rules" | "volumes" | "group_add" | "ports" | "extra_hosts":
                words += _listed(key, value, project)
            case "environment":
                words += [f"--env={name}={given}" for name, given in value.items()]
            case "stop_grace_period":
                words.append(f"--stop-timeout={value.removesuffix('s')}")
            case "configs":
                words += [f"--volume={configs[config['source']]}:{config['target']}:ro" for config in value]
            case "secrets":
                words += [f"--volume={file}:/run/secrets/{name}:ro" for name, file in value.items()]
            case "healthcheck":
                words += ["--health-cmd", value["test"][1], "--health-interval=disable"]
            case _ if key in PLAIN:
                words.append(f"{PLAIN[key]}={value}")
            case _ if key not in TAKEN_ELSEWHERE:
                raise TrialError(f"compose key '{key}' is not known to this trial")
    return words


def _listed(key: str, values: list[str], project: str) -> list[str]:
    option = {
        "devices": "device",
        "device_cgroup_rules": "device-cgroup-rule",
        "volumes": "volume",
        "ports": "publish",
        "extra_hosts": "add-host",
        "group_add": "group-add",
    }
    words = []
    for value in values:
        if key == "volumes" and not value.startswith(("/", ".")):
            value = f"{project}-{value}"  # a volume of this project
        words.append(f"--{option.get(key, key)}={value}")
    return words


def command_of(service: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """(options for the entrypoint, words after the image)."""
    entrypoint, command = list(service.get("entrypoint", [])), list(service["command"])
    if not entrypoint:
        return [], command
    return ["--entrypoint", entrypoint[0]], [*entrypoint[1:], *command]
