"""How a package that only some installs need is installed; it is in every error that misses one."""

from __future__ import annotations


def install_hint(extra: str) -> str:
    """The command that adds the extra `extra` of pyproject.toml. Tuberline is installed from a clone of its repository:
    no package index has it.
    """
    return f"in the clone of the repository: .venv/bin/pip install -e '.[{extra}]'"
