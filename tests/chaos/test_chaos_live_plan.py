"""The plan of the disturbed live runs is whole and fixed by its seed; its judge tells right from wrong."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from benchmarks.chaos_live_faults import KINDS, ROLES, WHENS, drawn_cases
from benchmarks.chaos_live_table import covered, inside, markdown, told, whole


def test_a_hundred_runs_hold_every_role_kind_and_time_once() -> None:
    cases = drawn_cases(7, 100, over_s=70.0)
    assert cases == drawn_cases(7, 100, over_s=70.0)
    assert cases[:30] == drawn_cases(7, 30, over_s=70.0)
    assert cases != drawn_cases(8, 100, over_s=70.0)
    first = Counter((case.faults[0].role, case.faults[0].kind, case.when) for case in cases)
    assert set(first.values()) == {1}
    assert len(first) == len(ROLES) * len(KINDS) * len(WHENS)
    for case in cases:
        assert all(0 < fault.at_s < 70.0 for fault in case.faults)
        if case.when == "two at once":
            assert case.faults[0].at_s == case.faults[1].at_s
            assert case.faults[0].role != case.faults[1].role


def run(**changed: Any) -> dict[str, Any]:
    """A run of which 80 of 100 tubers were counted."""
    case = drawn_cases(1, 1, over_s=70.0)[0].as_dict()
    totals = {"count": 80, "coverage": 0.8, "weight_g": 100.0, "low_g": 80.0, "high_g": 120.0, "balanced": True}
    truth = {"true_count": 100, "true_weighed_g": 110.0, "state": "ended", "down": [], "machine_load": [1.0, 2.0]}
    return {**case, **totals, **truth, **changed}


@pytest.mark.parametrize(
    ("changed", "verdict"),
    [
        ({}, (True, True, True)),
        ({"true_weighed_g": 130.0}, (False, True, True)),
        ({"coverage": 0.9}, (True, False, True)),
        ({"coverage": 0.7}, (True, False, True)),
        ({"down": ["router"]}, (True, True, False)),
        ({"balanced": False}, (True, True, False)),
        ({"state": "nothing seen", "count": 0, "coverage": None, "low_g": None}, (True, True, True)),
        ({"state": "nothing seen", "count": 10, "coverage": None, "low_g": None}, (False, False, True)),
    ],
)
def test_the_judge(changed: dict[str, Any], verdict: tuple[bool, bool, bool]) -> None:
    one = run(**changed)
    assert (inside(one), covered(one), whole(one)) == verdict
    assert told(one)
    assert f"**{int(verdict[0])}**" in markdown([one], seed=1)


def test_a_run_without_a_summary_passes_nothing() -> None:
    silent = {name: value for name, value in run().items() if name not in ("state", "count", "coverage", "balanced")}
    assert not inside(silent)
    assert not covered(silent)
    assert not whole(silent)
    assert "no summary" in told(silent)
