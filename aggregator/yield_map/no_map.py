"""Why there is no map of a field, for who has to say so while the machine drives."""

from __future__ import annotations

from enum import StrEnum

from conveyor.errors import InputError


class WhyNoMap(StrEnum):
    """What is missing."""

    NO_LEDGER = "no_ledger"
    NO_POSITIONS = "no_positions"
    NO_FIX = "no_fix"
    NO_TUBERS = "no_tubers"
    NO_GROUND = "no_ground"
    """Too little was lifted that can be used."""
    OTHER_TIMES = "other_times"
    """Tubers and positions are of different times."""


class NoMapError(InputError):
    """There is no map; `why` says it in a word, the text in full."""

    def __init__(self, text: str, *, why: WhyNoMap) -> None:
        super().__init__(text)
        self.why = why
