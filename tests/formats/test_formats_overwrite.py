"""A recording that takes another one's place: the former one stays until the new one is whole."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from conveyor.errors import InputError
from tuberline.cli.simulate import simulate


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.fixture
def former(small_recording: Path) -> Path:
    """A recording with a file of its user's in it."""
    (small_recording / "former.txt").write_text("goes with it")
    return small_recording


@pytest.mark.parametrize("named", [".", "link", "sub/.."])
def test_force_replaces_a_recording_however_its_folder_is_named(
    named: str, former: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Within it, as '.', all of it was removed and nothing made; by a link it was refused when all was simulated."""
    (former / "sub").mkdir()
    (tmp_path / "link").symlink_to(former)
    monkeypatch.chdir(tmp_path if named == "link" else former)
    with pytest.raises(InputError, match="add --force"):
        simulate(out=Path(named), tubers=1)
    simulate(out=Path(named), tubers=1, scene="singulated", fps=2, force=True)
    assert names(former) == {"front", "line.json", "truth.json"}
    assert len(json.loads((former / "truth.json").read_text())["tubers"]) == 1
    assert names(tmp_path) == {"recording", "link"}


def test_a_recording_stays_where_the_new_one_cannot_be_made(
    former: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = names(former)
    monkeypatch.chdir(former)
    with pytest.raises(InputError, match="must end in"):
        simulate(out=Path(), tubers=1, format="mcap", force=True)
    assert names(former) == before
    assert capsys.readouterr().out == ""


def test_what_a_recording_links_to_is_not_removed_with_it(former: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "kept").write_text("kept")
    os.symlink(tmp_path / "mine", former / "mine")
    simulate(out=former, tubers=1, scene="singulated", fps=2, force=True)
    assert names(former) == {"front", "line.json", "truth.json"}
    assert names(tmp_path / "mine") == {"kept"}
