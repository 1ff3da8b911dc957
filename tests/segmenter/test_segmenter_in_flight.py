"""Lost views are told from slow ones by the order of answers; how long to wait follows what answers took."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from segmenter.dispatch.in_flight import LEAST_PATIENCE_S, MOST_SENT, InFlight


@given(arrives=st.lists(st.booleans(), max_size=40), data=st.data())
def test_over_a_link_that_keeps_its_order_exactly_the_lost_views_before_an_answer_are_told(
    arrives: list[bool], data: st.DataObject
) -> None:
    flight, told, sent = InFlight(), set[str](), 0
    answers = [n for n, there in enumerate(arrives) if there]
    for answer in answers:
        before, sent = sent, data.draw(st.integers(max(sent, answer + 1), len(arrives)))
        for n in range(before, sent):
            flight.sent("a", str(n), 0.0)
        told |= set(flight.answered("a", str(answer), 0.1))
        assert told == {str(n) for n in range(answer) if not arrives[n]}


def test_the_answer_to_a_view_sent_twice_tells_nothing_of_the_others() -> None:
    flight = InFlight()
    for view_id in ("1", "2", "3", "1"):
        flight.sent("a", view_id, 0.0)
    assert flight.answered("a", "1", 0.1) == []
    assert flight.answered("a", "1", 0.1) == [], "the second copy's answer"
    assert flight.answered("a", "3", 0.1) == ["2"]


def test_answers_of_one_regressor_say_nothing_of_another_ones_views() -> None:
    flight = InFlight()
    flight.sent("a", "1", 0.0)
    flight.sent("b", "2", 0.0)
    assert flight.answered("b", "2", 0.1) == []
    assert flight.answered("b", "1", 0.1) == []
    assert flight.answered("a", "1", 0.1) == []


def test_nothing_is_remembered_without_bound_or_of_those_that_left() -> None:
    flight = InFlight()
    for n in range(MOST_SENT + 10):
        flight.sent("a", str(n), 0.0)
    assert flight.answered("a", "3", 1.0) == []
    assert len(flight.answered("a", str(MOST_SENT + 9), 1.0)) == MOST_SENT - 1
    flight.gone("a")
    assert flight.patience_s("a", at_most_s=5.0) == 5.0


@given(took_s=st.lists(st.floats(0.0, 30.0), min_size=1, max_size=50), misses=st.integers(0, 20))
def test_patience_lies_between_its_bounds_and_never_falls_with_a_miss(took_s: list[float], misses: int) -> None:
    flight = InFlight()
    for n, took in enumerate(took_s):
        flight.sent("a", str(n), 0.0)
        flight.answered("a", str(n), took)
    patience = [flight.patience_s("a", at_most_s=5.0)]
    for _ in range(misses):
        flight.missed("a")
        patience.append(flight.patience_s("a", at_most_s=5.0))
    assert all(LEAST_PATIENCE_S <= s <= 5.0 for s in patience)
    assert patience == sorted(patience)


@pytest.mark.parametrize("usual_s", [0.02, 0.2, 1.0])
def test_patience_is_several_times_what_answers_take(usual_s: float) -> None:
    flight = InFlight()
    for n in range(50):
        flight.sent("a", str(n), n)
        flight.answered("a", str(n), n + usual_s)
    assert flight.patience_s("a", at_most_s=5.0) == pytest.approx(max(LEAST_PATIENCE_S, 3 * usual_s), rel=0.02)
    flight.missed("a")
    assert flight.patience_s("a", at_most_s=5.0) == pytest.approx(
        min(2 * max(LEAST_PATIENCE_S, 3 * usual_s), 5.0), rel=0.02
    )
