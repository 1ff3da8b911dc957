"""What a training is refused for before it prepares a view, and what it leaves in its folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from conveyor.errors import InputError, OutputError
from regressor.network.checkpoint import save_checkpoint
from regressor.network.pointraft import PointRaft
from regressor.network.sidecar import Sidecar
from regressor.training.beginning import alone_in
from regressor.training.calibration import recalibrate
from regressor.training.loop import save_state
from regressor.training.recipe import TrainSettings
from regressor.training.run import RunOptions, load_sets, train
from regressor.training.train import Training
from tests.regressor.ellipsoids import write_pack
from tests.regressor.twin_folder import write_twin

ONE_STEP = TrainSettings(epochs=0.2, batch=8)
SILENT: dict[str, Any] = dict.fromkeys(("on_prepared", "on_step", "on_validated"), lambda *_: None)


@pytest.fixture(scope="module")
def packs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("packs")
    write_pack(folder / "train", tubers=8, views=2, seed=1)
    write_pack(folder / "val", tubers=4, views=2, seed=2)
    return folder


def _options(packs: Path, out: Path) -> RunOptions:
    return RunOptions(packs / "train", packs / "val", out, "x", False, 9.0, 9.0, 200, "tuberline train")


def test_two_trainings_share_no_folder(packs: Path, tmp_path: Path) -> None:
    """Both wrote one state, one log and one file of weights: what was left was of either, by chance."""
    out = tmp_path / "out"
    with alone_in(out), pytest.raises(OutputError, match=r"another process trains in .*out: wait .*another --out"):
        train(_options(packs, out), ONE_STEP, **SILENT)
    assert list(out.iterdir()) == []
    train(_options(packs, out), ONE_STEP, **SILENT)
    before = (out / "state.pt").read_bytes()
    with alone_in(out), pytest.raises(OutputError, match="another process trains"):
        train(replace(_options(packs, out), resume=True), ONE_STEP, **SILENT)
    assert (out / "state.pt").read_bytes() == before


def test_weights_without_a_state_are_not_overwritten(packs: Path, tmp_path: Path) -> None:
    """A variant of `ablate`, or a training whose state was taken away for its size, was trained over without a word."""
    out = tmp_path / "out"
    save_checkpoint(out / "weights.safetensors", PointRaft().state_dict(), Sidecar(name="kept"))
    before = (out / "weights.safetensors").read_bytes()
    with pytest.raises(InputError, match=r"already holds weights.safetensors, which .* overwrite: give another --out"):
        train(_options(packs, out), ONE_STEP, **SILENT)
    assert (out / "weights.safetensors").read_bytes() == before
    assert sorted(path.name for path in out.iterdir()) == ["weights.json", "weights.safetensors"]


@pytest.mark.parametrize(
    ("change", "settings", "words"),
    [
        ({}, replace(ONE_STEP, batch=17), "16 training views are fewer than one batch of 17: .*smaller --batch"),
        ({"start": "nowhere.safetensors"}, ONE_STEP, r"--start .*nowhere.safetensors is not there$"),
        ({"start": "."}, ONE_STEP, "--start .* is a folder: give the .safetensors file in it"),
        ({"start": "other.safetensors"}, ONE_STEP, "are not of pointraft's architecture"),
        ({"validation": "packs/nothing"}, ONE_STEP, "nothing is not there"),
        ({"out": "file"}, ONE_STEP, "--out .*file cannot be made: .*a file lies where a folder is needed"),
    ],
)
def test_what_can_be_told_at_once_is_told_before_views_are_prepared(
    packs: Path, tmp_path: Path, change: dict[str, str], settings: TrainSettings, words: str
) -> None:
    """They were told after all views had been prepared, and `out` with its cache stayed behind."""
    (tmp_path / "file").write_text("no folder")
    save_checkpoint(tmp_path / "other.safetensors", PointRaft(height_embedding=False).state_dict(), Sidecar(name="o"))
    changes = {name: tmp_path / value for name, value in change.items()}
    prepared: list[str] = []
    silent = {**SILENT, "on_prepared": lambda what, done: prepared.append(what)}
    with pytest.raises(InputError, match=words):
        train(replace(_options(packs, tmp_path / "out"), **changes), settings, **silent)
    assert not (tmp_path / "out").exists()
    assert prepared == []


def test_other_settings_are_refused_before_views_are_prepared(packs: Path, tmp_path: Path) -> None:
    first = _options(packs, tmp_path / "out")
    train(first, ONE_STEP, **SILENT)
    unread = replace(first, data=tmp_path / "moved", resume=True)
    write_pack(tmp_path / "moved", tubers=8, views=2, seed=3)
    with pytest.raises(InputError, match=r"begun otherwise: lr 0.001, now 0.5. A training goes on"):
        train(unread, replace(ONE_STEP, lr=0.5), **SILENT)


def test_a_shard_that_cannot_be_read_is_said_to_be_that(packs: Path, tmp_path: Path) -> None:
    """Not that there are fewer views than a batch."""
    (tmp_path / "cut").mkdir()
    (shard,) = (packs / "train").glob("views-*.npz")
    (tmp_path / "cut" / shard.name).write_bytes(shard.read_bytes()[:900])
    with pytest.raises(InputError, match=r"shard .*views-00000.npz cannot be read: .*make the pack again"):
        train(replace(_options(packs, tmp_path / "out"), data=tmp_path / "cut"), ONE_STEP, **SILENT)


def test_a_training_that_is_refused_leaves_no_folder(packs: Path, tmp_path: Path) -> None:
    """The prepared views of its validation stayed behind, in a folder that no training was in."""
    write_twin(tmp_path / "crop", tubers=8, weights_g=["0.12"] * 8)
    refused = replace(_options(packs, tmp_path / "out"), data=tmp_path / "crop")
    with pytest.raises(InputError, match=r"crop: a median weight of 0.12"):
        train(refused, ONE_STEP, **SILENT)
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match=r"crop: a median weight of 0.12"):
        train(refused, ONE_STEP, **SILENT)
    assert [path.name[:10] for path in (tmp_path / "out" / "cache").iterdir()] == ["clouds-val"], "it was there before"


def test_one_folder_for_both_is_said_to_have_no_parts(packs: Path, tmp_path: Path) -> None:
    """It said that a pack has no split 'val', which no one had asked for, or that splits.csv cannot be read."""
    same = replace(_options(packs, tmp_path / "out"), validation=packs / "train")
    with pytest.raises(InputError, match=r"--data and --val are both .*train, .*no splits.csv.*a pack of its own"):
        train(same, ONE_STEP, **SILENT)
    write_twin(tmp_path / "crop", tubers=4)
    crop = replace(same, data=tmp_path / "crop", validation=tmp_path / "crop" / ".")
    with pytest.raises(InputError, match=r"are both .*crop, .*`tuberline split .*crop` shares its tubers out"):
        train(crop, ONE_STEP, **SILENT)
    assert not (tmp_path / "out").exists()


def test_a_log_has_each_step_once_though_its_training_was_killed(packs: Path, tmp_path: Path) -> None:
    """What was validated after the last state stood there twice, so that the steps of a log fell back."""
    out, whole = tmp_path / "out", replace(ONE_STEP, epochs=2.0, best_epoch=True)  # validates after each epoch
    begun = _options(packs, out)
    train(begun, whole, **SILENT)
    full = (out / "log.csv").read_text(encoding="utf-8").splitlines()
    assert [line.split(",")[1] for line in full] == ["step", "2", "4"]
    killed = tmp_path / "killed"
    early = Training(*load_sets(replace(begun, out=killed), SILENT["on_prepared"]), whole)
    early.step()
    save_state(early, killed / "state.pt")
    (killed / "log.csv").write_text("\n".join([full[0], full[1], full[1][:9]]), encoding="utf-8")
    train(replace(begun, out=killed, resume=True), whole, **SILENT)
    again = (killed / "log.csv").read_text(encoding="utf-8").splitlines()
    assert [line.split(",")[1:] for line in again] == [line.split(",")[1:] for line in full]  # minutes are the clock's


def test_a_training_that_has_ended_is_left_as_it_is(packs: Path, tmp_path: Path) -> None:
    """`--resume` wrote its sidecar again, and what calibrations had made of it was gone without a word."""
    first = _options(packs, tmp_path / "out")
    train(first, ONE_STEP, **SILENT)
    write_pack(tmp_path / "fresh", tubers=24, views=1, seed=9)
    weights = tmp_path / "out" / "weights.safetensors"
    calibrated = recalibrate(weights, tmp_path / "fresh", cache=None, max_views=None)
    assert train(replace(first, resume=True), ONE_STEP, **SILENT) == calibrated
    weights.unlink()  # as of one that was killed before it wrote them
    assert train(replace(first, resume=True), ONE_STEP, **SILENT).metrics["interval"]["tubers"] == 4
