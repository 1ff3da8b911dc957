"""How often the network is asked about a track: once where that settles it, eight times where nothing does."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import fmean

import numpy as np
import pytest

from segmenter.classify.belief import ASKED, SPREAD, believe
from segmenter.classify.classifier import SIDES, Classifier
from segmenter.classify.evidence import PatchNoise
from segmenter.classify.patch import CHANNELS, SIZE, Patch
from segmenter.classify.prior import Prior
from segmenter.track.counting import CountSettings

LIMIT = CountSettings().reject_below
QUIET = PatchNoise(spread_mm=1.5, error_mm=0.3, hole_share=0.05, observations=28)


class Asked(Iterator[float]):
    """Eight answers, and how many of them were taken."""

    def __init__(self, answers: list[float]) -> None:
        self._left = list(answers)
        self.taken = 0

    def __next__(self) -> float:
        if not self._left:
            raise StopIteration
        self.taken += 1
        return self._left.pop(0)


@pytest.mark.parametrize("clear", [-9.0, 6.0])
def test_a_clear_patch_is_asked_about_once(clear: float) -> None:
    asked = Asked([clear] * len(SIDES))
    answer = believe(Prior(), asked, QUIET, limit=LIMIT)
    assert (asked.taken, answer.evidence.answers) == (1, (clear,))


def test_a_patch_at_the_limit_is_asked_about_from_all_sides() -> None:
    at_limit = LIMIT - Prior().log_odds(0.0)
    asked = Asked([at_limit + 0.1 * n for n in range(len(SIDES))])
    answer = believe(Prior(), asked, QUIET, limit=LIMIT)
    assert asked.taken == len(SIDES)
    assert answer.evidence.log_odds == pytest.approx(at_limit + 0.35)


def test_where_nothing_is_refused_all_answers_are_taken() -> None:
    asked = Asked([5.0] * len(SIDES))
    believe(Prior(), asked, QUIET, limit=-np.inf)
    assert asked.taken == len(SIDES)


def test_the_limit_moves_with_what_the_belt_has_shown() -> None:
    """The same answer is clear on a belt that has shown tubers only, and not on a cloddy one."""
    taken = []
    for before in ([5.0] * 100, [-7.0, 5.0] * 50):
        prior = Prior()
        for one in before:
            prior.learn(one)
        asked = Asked([-1.0] * len(SIDES))
        believe(prior, asked, QUIET, limit=LIMIT)
        taken.append(asked.taken)
    assert taken[0] == 1 < taken[1]


def test_few_answers_decide_as_all_eight_do() -> None:
    """Answers that spread as the network's do, over a cloddy belt: hardly any decision changes, few are asked for."""
    rng = np.random.default_rng(33)
    centres = np.where(rng.random(3000) < 0.3, rng.normal(-4.5, 2.0, 3000), rng.normal(4.0, 2.0, 3000))
    few, all_eight, taken, other = Prior(), Prior(), 0, 0
    for centre in centres:
        answers = (centre + SPREAD * rng.normal(size=len(SIDES))).tolist()
        asked = Asked(answers)
        decided = believe(few, asked, QUIET, limit=LIMIT).log_odds < LIMIT
        mean = fmean(answers)
        other += decided != (all_eight.log_odds(mean) < LIMIT)
        all_eight.learn(mean)
        taken += asked.taken
    assert other <= 3
    assert taken < 2.0 * len(centres)


def test_the_sides_are_all_there_are_and_each_is_its_own() -> None:
    """A patch of one marked corner: eight sides of two marks tell mirrored from turned."""
    image = np.zeros((1, SIZE, SIZE), np.float32)
    image[0, 2, 5] = 1.0
    sides = {np.rot90(image[:, :, ::-1] if mirrored else image, turns, (1, 2)).tobytes() for mirrored, turns in SIDES}
    assert len(sides) == len(SIDES) == ASKED[-1] == 8


def test_answers_are_made_when_they_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    classifier, seen = Classifier(), []
    real = classifier._network.answer
    monkeypatch.setattr(classifier._network, "answer", lambda channels: seen.append(channels.shape) or real(channels))
    answers = classifier.answers(Patch(observations=1))
    assert seen == []
    next(answers)
    assert seen == [(CHANNELS, SIZE, SIZE)]
    assert len(list(answers)) == len(SIDES) - 1
