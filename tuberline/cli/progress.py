"""Progress for people goes to stderr, results to stdout."""

from __future__ import annotations

from rich.console import Console


def console() -> Console:
    """A console on stderr."""
    return Console(stderr=True)
