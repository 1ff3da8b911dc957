"""Names of cultivars and fields as people type them: 'Agria', 'agria' and ' AGRIA' are one."""

from __future__ import annotations

from collections.abc import Iterable


def name_key(name: str) -> str:
    """What two ways to type one name have in common."""
    return " ".join(name.split()).casefold()


def as_first_given(names: Iterable[str]) -> dict[str, str]:
    """Each of `names` once: its key, and the name as it was first given."""
    found: dict[str, str] = {}
    for name in names:
        found.setdefault(name_key(name), name)
    return found
