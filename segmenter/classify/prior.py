"""How much of a load is no tuber, learned from the load itself: the same patch is a clod's oftener on a cloddy belt.

The classifier says how much likelier a patch is for a tuber than for a clod or a stone. What to believe also depends on
how many of them ride along. On a clean belt next to none do, and an odd tuber is given the benefit of the doubt; where
every fourth body was surely a clod, it is not. Each classified track counts for both sides by what was believed of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log

OTHERS, TUBERS = 0.5, 8.0
"""What is believed before anything was seen: one body in 17 is no tuber, held as lightly as eight bodies."""
KEEP = 0.995
"""Of what earlier tracks said, per track: the last 200 matter, a field's end is another soil than its beginning."""


@dataclass(slots=True)
class Prior:
    """Bodies of either sort so far, older ones fading."""

    others: float = OTHERS
    tubers: float = TUBERS

    def log_odds(self, evidence: float) -> float:
        """Log-odds of tuber against other for a body, from the log of how much likelier its patch is for a tuber.

        The body is taken into account for those after it.
        """
        odds = evidence + log(self.tubers / self.others)
        other = 1 / (1 + exp(min(max(odds, -50.0), 50.0)))
        self.others = OTHERS + (self.others - OTHERS) * KEEP + other
        self.tubers = TUBERS + (self.tubers - TUBERS) * KEEP + 1 - other
        return odds
