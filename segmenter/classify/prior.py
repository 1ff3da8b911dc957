"""How much of a load is no tuber, learned from the load itself: the same patch is a clod's oftener on a cloddy belt.

The classifier says how much likelier a patch is for a tuber than for a clod or a stone. What to believe also depends on
the share of others on this belt, which is not known. It is estimated as that of a mixture: each track makes every
possible share more or less likely (Bayes). A belt counts as clean until its tracks have shown that it rather is not,
and on a clean belt only strong evidence refuses a track.

A camera that is worse than those in training makes ordinary tubers look a little like clods, all of them; a cloddy belt
has some that look very much like clods. So a mild answer says nothing of the belt, and no single track proves much.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

# Tuned together on the seeds `tuning` of benchmarks/clods.py: 0 of 300 tubers lost on clean belts; on cloddy ones 8 of
# 480 lost and 16 of 122 clods and stones counted. In brackets: these three numbers at other values.
CLEAN_SHARE = 0.003
"""Share of others on a belt that counts as clean; 0.003 asks for 5.5 in log-odds there. Less asks for more evidence
(0.0015: 0, 8, 21; 0.006: 0, 8, 15)."""
CLEAN_BELIEF = 0.7
"""Probability that a belt is clean, before anything was seen. More: more clods are counted before it counts as cloddy,
and a bad camera's belt is less easily taken for one (0.5: 1, 10, 13; 0.85: 0, 7, 22)."""
MOST_SHARE = 0.6
"""Largest share of others that is believed (0.4 and 0.8: the same)."""
SHARES = 24
MILD = 1.0
"""Log-odds by which an answer may be for a clod and say nothing of the belt. More: steadier under a bad camera, blinder
to clods that are hard to tell (0.5: 1, 13, 15; 2: 0, 3, 39)."""
ODD = 0.01
"""Share of tubers that look like anything: one track makes no share more than 1 / ODD times as likely. More: more clods
must be seen before a belt counts as cloddy (0.005: 0, 10, 15; 0.02: 0, 7, 18)."""
KEEP = 0.995
"""Of what earlier tracks said, per track: the last 200 matter, a field's end is another soil than its beginning (0.99:
0, 9, 16; 0.998: 0, 8, 16)."""
LARGEST = 50.0
"""Log-odds beyond this say no more."""


def _shares() -> NDArray[np.float64]:
    """(24,) possible shares of others, the first that of a clean belt."""
    return np.asarray(np.geomspace(CLEAN_SHARE, MOST_SHARE, SHARES), np.float64)


def _before() -> NDArray[np.float64]:
    """(24,) log of how likely each share is before anything was seen."""
    belief = np.full(SHARES, (1 - CLEAN_BELIEF) / (SHARES - 1))
    belief[0] = CLEAN_BELIEF
    return np.asarray(np.log(belief), np.float64)


@dataclass(slots=True)
class Prior:
    """What the tracks so far say of the share of others, older ones fading; `said` is (24,) log-likelihoods."""

    said: NDArray[np.float64] = field(default_factory=lambda: np.zeros(SHARES))

    @property
    def share(self) -> float:
        """The share of others to reckon with: a clean belt's until others are likelier than not, then the expected."""
        belief = _before() + self.said
        weight = np.exp(belief - belief.max())
        weight /= weight.sum()
        return CLEAN_SHARE if weight[0] >= 0.5 else float(weight @ _shares())

    def log_odds(self, evidence: float) -> float:
        """Log-odds of tuber against other for a body, from the log of how much likelier its patch is for a tuber.

        The body is taken into account for those after it.
        """
        share = self.share
        self.said = KEEP * self.said + _said(evidence)
        return evidence + float(np.log((1 - share) / share))


def _said(evidence: float) -> NDArray[np.float64]:
    """(24,) log of how likely a body with this evidence is for each share of others; mild evidence says little."""
    clear = max(-LARGEST, evidence + MILD) if evidence < -MILD else min(max(evidence, 0.0), LARGEST)
    ratio = np.exp(-clear)
    ratio = ((1 - ODD) * ratio + ODD) / (1 - ODD + ODD * ratio)
    shares = _shares()
    return np.asarray(np.log(1 - shares + shares * ratio))
