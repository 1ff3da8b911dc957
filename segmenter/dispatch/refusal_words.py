"""The words by which regressors refuse views, few enough for a mark to hold a count of each."""

from __future__ import annotations

from collections.abc import Iterable

from conveyor.reasons import ViewLoss

MOST_WORDS = 64
"""Of one camera in one run. Ours has six; one that is brought may put numbers into its words, and a mark with more than
256 counts cannot be sent (`conveyor.ranges.Sheet`)."""
MOST_LETTERS = 40
OTHER = "other"
"""Of a refusal for which there is no word left."""
_PREFIX = f"lost_{ViewLoss.REFUSED}_"


class RefusalWords:
    """The first `MOST_WORDS` words that come are told as they are."""

    def __init__(self) -> None:
        self._words = {OTHER}

    def know(self, sheet: Iterable[str]) -> None:
        """Names of an earlier process's sheet of views: its words go on."""
        self._words.update(name.removeprefix(_PREFIX) for name in sheet if name.startswith(_PREFIX))

    def word(self, reason: str) -> str:
        """What a refusal for `reason` is counted by; "" where there is none."""
        word = reason[:MOST_LETTERS]
        if not word or word in self._words:
            return word
        if len(self._words) > MOST_WORDS:
            return OTHER
        self._words.add(word)
        return word
