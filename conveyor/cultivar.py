"""Cultivars by the names that people type: 'Agria', 'agria' and ' AGRIA' are one."""

from __future__ import annotations

from collections.abc import Iterable


def cultivar_key(name: str) -> str:
    """What two names of one cultivar have in common."""
    return " ".join(name.split()).casefold()


def as_first_given(names: Iterable[str]) -> dict[str, str]:
    """Each cultivar among `names` once: its key, and its name as it was first given."""
    found: dict[str, str] = {}
    for name in names:
        found.setdefault(cultivar_key(name), name)
    return found
