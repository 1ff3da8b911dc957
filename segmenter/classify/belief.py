"""What to believe of a track: the network is asked as often as the decision needs."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from math import inf, isfinite, sqrt

from segmenter.classify.classifier import SIDES
from segmenter.classify.evidence import Answer, Evidence, PatchNoise, shrunk
from segmenter.classify.prior import Prior

SPREAD = 0.65
"""Standard deviation of one answer about the mean of all eight, at most: 0.54 to 0.63 where that is -2 to 2, 0.31 to
0.50 beyond (2035 tracks of the seeds `judging` and `harsh` of benchmarks/clods.py)."""
CLEAR = 3.5
"""Standard deviations by which a mean of answers must lie off the limit for no more to be asked. On those tracks 1.2
are asked in the mean, and one decision in 2000 is another than that of all eight."""
ASKED = (1, 2, 4, 8)
"""Numbers of answers after which it is looked at whether they are clear."""


def believe(prior: Prior, answers: Iterable[float], noise: PatchNoise, *, limit: float) -> Answer | None:
    """What is believed of a track whose patch gets these answers; call it once per track, for `prior` learns from it.
    None where an answer is no number: a network that diverged, or one of somebody's own; `prior` learns nothing then.

    Args:
        answers: of `Classifier.answers`; no more are taken than are needed.
        noise: of the patch.
        limit: log-odds below which the track is refused; -inf: nothing is refused, and all answers are taken.
    """
    coming = iter(answers)
    given: tuple[float, ...] = ()
    for count in ASKED:
        given += tuple(islice(coming, count - len(given)))
        evidence = Evidence(given, noise)
        if not isfinite(evidence.log_odds):
            return None
        log_odds = prior.log_odds(shrunk(evidence))
        if _spread(count) * CLEAR < abs(log_odds - limit) < inf:
            break
    # What is doubtful of one track for its noise still counts for the belt: all tracks together show clods.
    prior.learn(evidence.log_odds)
    return Answer(log_odds, evidence)


def _spread(count: int) -> float:
    """Standard deviation of the mean of `count` answers of the eight about the mean of all."""
    return SPREAD * sqrt((len(SIDES) / count - 1) / (len(SIDES) - 1))
