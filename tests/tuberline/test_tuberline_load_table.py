"""The table of loads in a terminal of 80 columns."""

from __future__ import annotations

import pytest

from tuberline.cli.load_table import print_loads

SAID = {"trailer": "", "customer": "", "operator": "", "field": "North 4", "variety": "Agria", "undone": False}


def test_an_interval_has_two_ends_and_a_trailer_of_tons_its_ticket(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a load whose belt was mostly missed it said '9.04 ± 11.83' kg, as if it might weigh less than nothing."""
    monkeypatch.setenv("COLUMNS", "80")
    times = {"began_unix_s": 1.79e9, "ended_unix_s": 1.79e9 + 600, "open": False, "count": 19, "coverage": 0.403}
    missed = {"estimated_weight_g": 9040.0, "estimated_low_g": 3430.0, "estimated_high_g": 27100.0, "net_g": None}
    heavy = {"estimated_weight_g": 104.2e6, "estimated_low_g": 95e6, "estimated_high_g": 112e6, "net_g": 103.1e6}
    print_loads([{**SAID, **times, **missed, "number": 2, "name": "trailer 7"}])
    print_loads([{**SAID, **times, **heavy, "number": 1, "name": "Überlingen am See, Schlag 17b"}])
    told = capsys.readouterr().out
    for part in ("9.04 ", "3.43 to 27.10", "40.3 %", "104200 ", "95000 to 112000", "103100.0"):
        assert part in told, told
