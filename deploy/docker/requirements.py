"""The packages of an image, out of pyproject.toml: `requirements.py [--without NAME] [--only] EXTRA...`, one a line.

An image for the nodes of a line has everything but torch, which training, a GPU and bfloat16 need. `--only` leaves
out what the package itself needs, for a layer on top. Plain Python: it runs before anything is installed.
"""

from __future__ import annotations

import argparse
import re
import tomllib
from pathlib import Path


def requirements(project: dict[str, object], extras: list[str], *, without: list[str], only: bool) -> list[str]:
    """Requirements of the package and these extras, sorted; an extra that is not there is an error."""
    known: dict[str, list[str]] = project["optional-dependencies"]  # type: ignore[assignment]
    for extra in extras:
        if extra not in known:
            raise SystemExit(f"requirements.py: extra '{extra}' is not in pyproject.toml; known: {', '.join(known)}")
    needed: list[str] = [] if only else list(project["dependencies"])  # type: ignore[call-overload]
    for extra in extras:
        needed += known[extra]
    return sorted({line for line in needed if re.split(r"[^\w.-]", line)[0] not in without})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("extras", nargs="*")
    parser.add_argument("--without", action="append", default=[])
    parser.add_argument("--only", action="store_true")
    given = parser.parse_args()
    project = tomllib.loads((Path.cwd() / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    print("\n".join(requirements(project, given.extras, without=given.without, only=given.only)))


if __name__ == "__main__":
    main()
