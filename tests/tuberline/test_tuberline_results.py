"""Evaluation page and model card are made from the same saved results and cannot contradict each other."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from conveyor.errors import InputError
from regressor.studies.card import model_card
from regressor.studies.page import saved_page
from regressor.studies.saved import Saved

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "results"
INTERVALS = re.compile(r"90 % intervals cover .*?\n")


def test_card_and_page_say_the_same_of_intervals_and_methods() -> None:
    card, page = model_card(Saved(RESULTS)), saved_page(Saved(RESULTS), image=None)
    for name in ("field", "easy", "season"):
        measured = json.loads((RESULTS / name / "metrics.json").read_text(encoding="utf-8"))
        loads = f"{100 * measured['coverage']['loads']:.1f} % of loads of 300 drawn"
        assert loads in card
        assert loads in page
    assert set(INTERVALS.findall(card)) == set(INTERVALS.findall(page))
    tables = [line for line in card.splitlines() if line.startswith("| PointRAFT")]
    assert len(tables) == 6
    assert all(line in page for line in tables)


def test_a_new_result_changes_both(tmp_path: Path) -> None:
    results = Path(shutil.copytree(RESULTS, tmp_path / "results"))
    file = results / "easy" / "metrics.json"
    measured = json.loads(file.read_text(encoding="utf-8"))
    measured["coverage"]["loads"] = 0.123
    file.write_text(json.dumps(measured), encoding="utf-8")
    assert "12.3 % of loads" in model_card(Saved(results))
    assert "12.3 % of loads" in saved_page(Saved(results), image=None)


def test_results_of_other_weights_make_no_card(tmp_path: Path) -> None:
    results = Path(shutil.copytree(RESULTS, tmp_path / "results"))
    file = results / "field" / "metrics.json"
    file.write_text(file.read_text(encoding="utf-8").replace("tuberline-sim@", "other@"), encoding="utf-8")
    with pytest.raises(
        InputError, match=r"was measured with other@\w+, the card is of tuberline-sim@\w+: make it again"
    ):
        model_card(Saved(results))


def test_the_real_cloud_weighs_what_the_card_says(shared: Path) -> None:
    import tuberline

    for cloud in json.loads(Saved(RESULTS).real.read_text(encoding="utf-8")):
        path = shared / "data" / "potatotwin_sample" / cloud["path"]
        if not path.is_file():
            pytest.skip(f"{path} is not at hand")
        weight = tuberline.weigh(path, belt_distance_m=cloud["belt_distance_m"])
        assert weight.model == cloud["model"]
        assert weight.weight_g == pytest.approx(cloud["weight_g"], abs=0.1)
        assert (weight.low_g, weight.high_g) == pytest.approx((cloud["low_g"], cloud["high_g"]), abs=0.2)
