"""The files of the page, read once when it starts. Nothing else on this machine can be asked for."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources

KINDS = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
    "json": "application/json",
    "txt": "text/plain; charset=utf-8",
}


@dataclass(frozen=True, slots=True)
class File:
    """What is sent for a path: its content type and its bytes."""

    kind: str
    content: bytes


def read_files() -> dict[str, File]:
    """Every file of viewer/page/static by its path, and of `shipped` below it: others' libraries with their licences.

    The page itself is also '/'.
    """
    folder = resources.files("viewer.page") / "static"
    found = {
        f"/{head}{entry.name}": File(KINDS[entry.name.rpartition(".")[2]], entry.read_bytes())
        for head, place in (("", folder), ("shipped/", folder / "shipped"))
        for entry in place.iterdir()
        if entry.name.rpartition(".")[2] in KINDS
    }
    return {**found, "/": found["/index.html"]}
