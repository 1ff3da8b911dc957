"""How far below the belt the tubers of a 3DPotatoTwin folder lie: who says it, and that it is said."""

from __future__ import annotations

from pathlib import Path

import pytest

from conveyor.errors import InputError
from conveyor.formats.potatotwin.resting import level_of, resting_told
from conveyor.resting import POTATOTWIN, RestingLevel


def _folder(path: Path, header: str, *rows: str) -> Path:
    (path / "1_rgbd").mkdir(exist_ok=True)
    (path / "ground_truth.csv").write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def test_a_folder_that_says_nothing_is_taken_for_the_data_set_and_that_is_told(tmp_path: Path) -> None:
    """An own crop in the layout that docs/train.md gives was trained and judged 5.5 mm below its belt, and weighed on
    it, 10 % lighter. Nothing said so.
    """
    folder = _folder(tmp_path, "label,growing_season,weight_g_inctack", "a,2023,120")
    assert level_of(folder) == (POTATOTWIN, "measured")
    told = resting_told(folder)
    assert "5.5 mm below the belt (sd 1.5 mm), as measured on R9-9 of 3DPotatoTwin" in told
    assert "columns resting_offset_mm" in told


@pytest.mark.parametrize(
    ("header", "row", "level", "told"),
    [
        ("label,belt_distance_m", "a,0.5", RestingLevel(), ""),
        ("label,my_belt_distance_m", "a,0.5", POTATOTWIN, "measured on R9-9"),
        ("label,resting_offset_mm", "a,0", RestingLevel(), ""),
        ("label,resting_offset_mm,resting_sd_mm", "a,3,1", RestingLevel(offset_m=0.003, sd_m=0.001), "3 mm below"),
        ("label,belt_distance_m,resting_offset_mm", "a,0.5,-2", RestingLevel(offset_m=-0.002), "-2 mm below"),
        ("label,resting_offset_mm", "a,", RestingLevel(), ""),
    ],
)
def test_a_table_states_the_level(header: str, row: str, level: RestingLevel, told: str, tmp_path: Path) -> None:
    folder = _folder(tmp_path, header, row)
    assert level_of(folder)[0] == level
    assert told in resting_told(folder)
    assert bool(resting_told(folder)) == bool(told)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (["a,five"], r"resting_offset_mm is 'five'; allowed are millimetres, -20 to 40"),
        (["a,0.0055", "b,41"], r"resting_offset_mm is '41'; allowed"),
        (["a,3", "b,5"], r"resting_offset_mm is '3' and '5'; a folder has one belt"),
    ],
)
def test_a_level_that_is_none_is_refused(rows: list[str], words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words):
        level_of(_folder(tmp_path, "label,resting_offset_mm", *rows))


def test_another_layout_has_nothing_to_tell(tmp_path: Path) -> None:
    assert resting_told(tmp_path) == ""
