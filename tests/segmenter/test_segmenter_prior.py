"""What a line believes of its belt: clean until proven, few strong clods prove it, many doubtful tubers do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from segmenter.classify import prior as prior_module
from segmenter.classify.evidence import Evidence, PatchNoise, shrunk
from segmenter.classify.prior import ENOUGH, FEW, MILD, MOST_ADDED, MOST_LIKE, NEWEST, Prior
from segmenter.track.counting import CountSettings

REFUSED_BELOW = CountSettings().reject_below
CLOD, TUBER = -7.0, 5.0
QUIET = PatchNoise(spread_mm=1.5, error_mm=0.3, hole_share=0.05, observations=28)


def after(evidence: list[float]) -> Prior:
    prior = Prior()
    for one in evidence:
        prior.learn(one)
    return prior


def refuses(prior: Prior, evidence: float) -> bool:
    return prior.log_odds(evidence) < REFUSED_BELOW


def test_without_evidence_nothing_is_refused() -> None:
    """On a belt that has shown nothing, and on one that has shown tubers only."""
    for before in ([], [TUBER] * 5, [TUBER] * 1000):
        for evidence in (-2.0, -1.0, 0.0, 2.0):
            assert not refuses(after(before), evidence), (len(before), evidence)


def test_strong_evidence_still_refuses_on_a_clean_belt() -> None:
    for before in ([], [TUBER] * 1000):
        assert refuses(after(before), CLOD), len(before)
    assert not refuses(after([TUBER] * 1000), -4.0)


def test_many_doubtful_tubers_prove_no_clods() -> None:
    """A camera that is worse than those in training moves all answers a little; none of them is strong."""
    rng = np.random.default_rng(31)
    doubtful = rng.uniform(-MILD, 2.0, 500).tolist()
    assert after(doubtful).share <= Prior().share


def test_a_few_strong_clods_prove_a_cloddy_belt() -> None:
    """The same doubtful body is counted before they came, and refused after."""
    assert not refuses(Prior(), -1.5)
    cloddy = after([CLOD if n % 4 == 0 else TUBER for n in range(40)])
    assert cloddy.share == pytest.approx(0.25, abs=0.06)
    assert refuses(cloddy, -1.5)


def test_one_odd_tuber_does_not_make_a_belt_cloddy() -> None:
    odd = after([TUBER] * 100 + [-30.0])
    assert odd.share < 0.03
    assert not refuses(odd, -2.0)


def test_a_field_that_becomes_clean_is_believed() -> None:
    cloddy = [CLOD if n % 4 == 0 else TUBER for n in range(200)]
    assert refuses(after(cloddy), -1.5)
    assert not refuses(after(cloddy + [TUBER] * 800), -1.5)


def test_more_evidence_for_a_clod_never_makes_it_likelier_to_be_counted() -> None:
    prior = after([TUBER, CLOD] * 10)
    assert np.all(np.diff([prior.log_odds(evidence) for evidence in np.linspace(-20, 20, 81).tolist()]) > 0)
    clods, tubers = Prior(prior.said.copy()), Prior(prior.said.copy())
    clods.learn(CLOD)
    tubers.learn(TUBER)
    assert tubers.share < prior.share < clods.share


def test_a_camera_before_which_no_tuber_is_clear_has_its_answers_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where depth was matched of two small images: the best of forty tubers get answers of 1 to 2."""
    low = np.random.default_rng(33).normal(-0.4, 1.8, 300).tolist()
    assert after(low).added == pytest.approx(MOST_ADDED * NEWEST / (NEWEST + FEW))
    refused = refused_of(low)
    monkeypatch.setattr(prior_module, "MOST_ADDED", 0.0)
    assert refused_of(low) >= 10
    assert refused <= refused_of(low) / 10


def refused_of(evidence: list[float]) -> int:
    prior, refused = Prior(), 0
    for one in evidence:
        refused += refuses(prior, one)
        prior.learn(one)
    return refused


def test_nothing_is_added_where_tubers_and_clods_are_clear() -> None:
    for every in (2, 4, 50):
        assert after([CLOD if n % every == 0 else TUBER for n in range(60)]).added == 0
    for only in (CLOD, TUBER):
        assert after([only] * 40).added == 0


def test_what_is_added_grows_with_the_answers_in_the_gap_and_with_their_number() -> None:
    few = after([0.5] * (FEW - 1))
    assert few.added == 0
    few.learn(0.5)
    assert few.added == MOST_ADDED / 2
    of_sixty = [after([0.5] * n + [TUBER] * (60 - n)).added for n in range(0, 61, 5)]
    assert of_sixty == sorted(of_sixty)
    assert of_sixty[2] == 0 < of_sixty[3]  # a fifth is usual
    assert of_sixty[-1] == pytest.approx(MOST_ADDED * 60 / (60 + FEW))
    assert after([0.5] * 60 + [TUBER] * 60).added == 0  # the camera's lens was cleaned


def test_more_clods_than_a_belt_can_carry_are_not_believed() -> None:
    """It takes `ENOUGH` bodies to say so, and ends when tubers look like tubers again."""
    assert after([CLOD] * (ENOUGH - 1)).like_clods == 0
    camera = after([CLOD] * ENOUGH)
    assert camera.like_clods == 1.0
    for _ in range(NEWEST):
        camera.learn(TUBER)
    assert camera.like_clods == 0
    of_ten = [after([CLOD] * 6 * n + [TUBER] * (60 - 6 * n)).like_clods for n in range(11)]
    assert of_ten == [0] * 8 + [0.8, 0.9, 1.0], f"believed up to {MOST_LIKE}"
    doubtful = [-MILD] * 60
    assert after(doubtful).like_clods == 0, "weak answers say nothing"


def test_the_same_tracks_in_the_same_order_say_the_same_to_the_bit() -> None:
    rng = np.random.default_rng(32)
    tracks = rng.normal(2, 4, 300).tolist()
    assert np.array_equal(after(tracks).said, after(tracks).said)


def test_answers_beyond_all_measure_do_no_harm() -> None:
    prior = Prior()
    assert prior.log_odds(1e4) > 1e3
    assert prior.log_odds(-1e4) < -1e3
    prior.learn(1e4)
    prior.learn(-1e4)
    assert np.isfinite(prior.said).all()


def test_noise_only_ever_shrinks_what_is_said() -> None:
    """Never to another sign, never more; the more noise the less, and a patch as in training keeps its answer."""
    for log_odds in (-8.0, -2.0, 0.0, 3.0, 9.0):
        assert shrunk(Evidence((log_odds,), QUIET)) == log_odds
        noises = [replace(QUIET, error_mm=error_mm) for error_mm in (0.3, 0.6, 0.9, 2.0, 50.0)]
        said = [shrunk(Evidence((log_odds,), noise)) for noise in noises]
        assert all(one == 0 or np.sign(one) == np.sign(log_odds) for one in said), said
        assert np.all(np.abs(said) <= abs(log_odds)), said
        assert np.all(np.diff(np.abs(said)) <= 0), said
