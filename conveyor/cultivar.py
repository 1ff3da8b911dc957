"""Cultivars by the names that people type."""

from __future__ import annotations

from conveyor.typed_names import name_key


def cultivar_key(name: str) -> str:
    """What two names of one cultivar have in common."""
    return name_key(name)
