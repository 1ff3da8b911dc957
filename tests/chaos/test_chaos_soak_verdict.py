"""The soak's verdict can fail: a leak is told from the noise of a process that is restarted again and again."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from benchmarks.soak_verdict import Sample, line_verdict, role_verdict

MINUTES = 30


def lives(*, each_min: float, leak_mib_h: float, seed: int, descriptors_h: float = 0.0) -> list[Sample]:
    """A process restarted every so often, sampled every 5 s; it loads for a minute and then wobbles by 2 MiB."""
    rng = random.Random(seed)
    samples = []
    for at_s in range(0, MINUTES * 60, 5):
        life, age_s = divmod(float(at_s), each_min * 60)
        loaded = 400.0 * min(1.0, age_s / 60) + rng.uniform(-2.0, 2.0) + 5.0 * (life % 2)
        grown = max(0.0, age_s - 60) / 3600
        samples.append(
            Sample(
                float(at_s), age_s, 100 * seed + int(life), loaded + leak_mib_h * grown,
                loaded + leak_mib_h * grown, 16 + int(descriptors_h * grown), 8,
            )
        )  # fmt: skip
    return samples


@pytest.mark.parametrize("each_min", [5, 30])
def test_a_leak_is_found_over_all_lives_and_a_flat_process_is_called_flat(each_min: float) -> None:
    flat = role_verdict("flat", lives(each_min=each_min, leak_mib_h=0.0, seed=1))
    leaking = role_verdict("leaking", lives(each_min=each_min, leak_mib_h=200.0, seed=2))
    assert flat is not None
    assert leaking is not None
    assert (flat.word, flat.lives, len(flat.per_life)) == ("flat", 30 // each_min, 30 // each_min)
    assert leaking.word == "grows"
    growth = leaking.pooled["own_mib"]
    assert growth is not None
    assert growth.per_h == pytest.approx(200.0, rel=0.1)
    assert growth.low_per_h < 200.0 < growth.high_per_h


def test_descriptors_that_are_never_closed_are_found() -> None:
    found = role_verdict("r", lives(each_min=30, leak_mib_h=0.0, seed=3, descriptors_h=60.0))
    assert found is not None
    assert found.word == "grows"
    assert found.pooled["threads"] is not None
    assert found.pooled["threads"].verdict == "flat"


@pytest.mark.parametrize(("filled_min", "word"), [(13, "settled"), (29, "grows")])
def test_a_cache_that_is_filled_once_is_told_from_what_never_ends(filled_min: float, word: str) -> None:
    """An aggregator whose cache held its 4096 tubers after 12 minutes of 30 was called a leak."""
    flat = lives(each_min=30, leak_mib_h=0.0, seed=5)
    filling = [replace(s, own_mib=s.own_mib + 40.0 * min(1.0, s.at_s / 60 / filled_min)) for s in flat]
    found = role_verdict("aggregator", filling)
    assert found is not None
    assert found.word == word
    rss = found.pooled["own_mib"]
    assert rss is not None
    assert rss.late is not None
    assert (abs(rss.late[0]) < 10.0) == (word == "settled")


def test_the_whole_line_is_measured_where_everybody_has_settled() -> None:
    calm = {"a": lives(each_min=5, leak_mib_h=0.0, seed=1), "b": lives(each_min=30, leak_mib_h=0.0, seed=2)}
    line = line_verdict(dict(calm))
    assert line is not None
    assert line.verdict == "flat"
    assert line.measured_s == pytest.approx(6 * 210, abs=60)
    leaky = line_verdict({**calm, "b": lives(each_min=30, leak_mib_h=300.0, seed=2)})
    assert leaky is not None
    assert leaky.verdict == "grows"


def test_what_never_lived_long_enough_gets_no_verdict() -> None:
    assert role_verdict("short", lives(each_min=1, leak_mib_h=500.0, seed=4)) is None
