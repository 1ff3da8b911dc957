"""Data of one's own in the layout of 3DPotatoTwin: what is read is what lies there, and parts stay apart."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from safetensors.numpy import save_file

from conveyor.errors import InputError
from conveyor.formats.potatotwin.layout import labels_of_split
from regressor.network.checkpoint import load_checkpoint, save_checkpoint
from regressor.network.stored import load_weights
from regressor.studies.evaluate import NETWORK, VOLUME_RULE, evaluate, method_scores
from regressor.studies.report import markdown, summary
from regressor.training.begun import digest_of
from regressor.training.calibration import recalibrate
from regressor.training.cloudset import CloudSet, load_cloudset
from regressor.training.labelled import read_labelled
from regressor.training.recipe import TrainSettings
from regressor.training.run import RunOptions, load_sets, train
from regressor.training.split import write_splits
from regressor.weigh.files import FileOptions, prepare_file
from regressor.weigh.weigher import Weigher
from tests.regressor.ellipsoids import write_pack
from tests.regressor.twin_folder import write_parts, write_twin
from tuberline.cli.evaluate import evaluate as evaluate_command
from tuberline.cli.split import split as split_command
from tuberline.cli.twin_told import tell_trained_resting, tell_twin


def test_the_cache_notices_other_splits_and_another_camera(tmp_path: Path) -> None:
    """Neither was part of the cache's name: a test tuber of the new splits.csv stayed in the training set."""
    labels = write_twin(tmp_path / "crop", tubers=4)
    write_parts(tmp_path / "crop", {"train": labels[:3], "test": labels[3:]})
    first = load_cloudset(tmp_path / "crop", split="train", cache=tmp_path / "cache")
    write_parts(tmp_path / "crop", {"train": labels[1:], "test": labels[:1]})
    second = load_cloudset(tmp_path / "crop", split="train", cache=tmp_path / "cache")
    assert first.tuber.tolist() == labels[:3]
    assert second.tuber.tolist() == labels[1:]
    (camera,) = (tmp_path / "crop" / "1_rgbd" / "0_camera_intrinsics").iterdir()
    told = json.loads(camera.read_text(encoding="utf-8"))
    told["intrinsic_matrix"][0] *= 2
    camera.write_text(json.dumps(told), encoding="utf-8")
    third = load_cloudset(tmp_path / "crop", split="train", cache=tmp_path / "cache")
    assert np.ptp(third.points[0], axis=0)[0] == pytest.approx(np.ptp(second.points[0], axis=0)[0] / 2, rel=0.02)


def _sets(data: Path, validation: Path, out: Path) -> tuple[CloudSet, CloudSet]:
    options = RunOptions(data, validation, out, "x", False, 9.0, 9.0, 200, "tuberline train")
    return load_sets(options, lambda what, done: None)


def test_tubers_of_one_weight_are_not_one_tuber(tmp_path: Path) -> None:
    """Without a volume two tubers of 120 g were taken for one: with a scale that shows 5 g, a quarter of a training set
    was thrown away as being in the validation set too, and nothing counted it.
    """
    labels = write_twin(tmp_path / "crop", tubers=6, weights_g=["120"] * 6)
    write_parts(tmp_path / "crop", {"train": labels[:4], "val": labels[4:]})
    data, validation = _sets(tmp_path / "crop", tmp_path / "crop", tmp_path / "out")
    assert data.tuber.tolist() == labels[:4]
    assert validation.tuber.tolist() == labels[4:]
    assert data.refused == {}


def test_tubers_of_the_validation_set_are_counted_where_they_are_left_out(tmp_path: Path) -> None:
    """docs/train.md says that a training tells of them; nothing did."""
    write_twin(tmp_path / "crop", tubers=4)
    write_twin(tmp_path / "part", tubers=2)
    data, _ = _sets(tmp_path / "crop", tmp_path / "part", tmp_path / "out")
    assert data.tuber.tolist() == ["t002", "t003"]
    assert data.refused == {"in_validation": 2}


def test_a_tuber_belongs_to_one_part(tmp_path: Path) -> None:
    """A label in 'train' and in 'test' was trained on and tested; one with a blank beside it was in neither."""
    write_parts(tmp_path, {"train": ["a", " b"], "test ": ["c"]})
    assert labels_of_split(tmp_path, "train") == {"a", "b"}
    assert labels_of_split(tmp_path, "test") == {"c"}
    write_parts(tmp_path, {"train": ["a", "b"], "test": ["b", "c"]})
    with pytest.raises(InputError, match=r"line 4: label 'b' is in 'test' and in 'train' before"):
        labels_of_split(tmp_path, "train")


def test_a_row_that_stands_twice_is_one_tuber(tmp_path: Path) -> None:
    """`tuberline split` drew each row of the table: one that stands there twice came into two parts."""
    rows = [f"t{number:03d}, {60 + 3 * number}" for number in range(40)]
    table = "\n".join(["label,weight_g_inctack", *rows, *rows[:20]])
    (tmp_path / "ground_truth.csv").write_text(table + "\n", encoding="utf-8")
    assert write_splits(tmp_path) == {"train": 24, "val": 8, "test": 8}
    parts = [labels_of_split(tmp_path, part) for part in ("train", "val", "test")]
    assert sum(map(len, parts)) == len(set.union(*parts)) == 40


@pytest.mark.parametrize("weight", ["nan", "NA", ""])
def test_a_split_needs_every_weight(tmp_path: Path, weight: str) -> None:
    """'nan' is a number to Python: all weight classes became one, and the parts had other weights."""
    rows = [f"t{number:03d},{60 + 3 * number}" for number in range(40)]
    (tmp_path / "ground_truth.csv").write_text("\n".join(["label,weight_g_inctack", *rows, f"odd,{weight}"]))
    with pytest.raises(
        InputError, match=rf"'odd' has weight_g_inctack '{weight}', which is no number of grams.*\(1 labels"
    ):
        write_splits(tmp_path)


@pytest.mark.parametrize("belt_distance_m", [0.54, 0.62])
def test_a_belt_farther_than_the_reference_s_is_read_to_its_ground(tmp_path: Path, belt_distance_m: float) -> None:
    """A training cut every tuber off at 0.5 m, `weigh` did not: at 0.54 m a third of the points was gone, at 0.6 m the
    folder was refused.
    """
    (label,) = write_twin(tmp_path, tubers=1, belt_distance_m=belt_distance_m)
    image = tmp_path / "1_rgbd" / "1_image" / label / f"{label}_depth_360.png"
    weighed = prepare_file(image, FileOptions(belt_distance_m=belt_distance_m))
    learned = load_cloudset(tmp_path)
    assert learned.points_in_cloud.tolist() == [len(weighed.points)]
    assert learned.features[0] == pytest.approx(weighed.surface.as_array())


@pytest.mark.parametrize("weight", ["0", "-999"])
def test_a_weight_that_none_has_is_refused(tmp_path: Path, weight: str) -> None:
    """One 0 in 2000 rows made the volume rule of the whole training NaN; a -999 ended it with a traceback."""
    write_twin(tmp_path / "crop", tubers=2, weights_g=["120", weight])
    with pytest.raises(InputError, match=rf"label 't001' has weight_g_inctack {weight}; allowed are grams above 0"):
        load_cloudset(tmp_path / "crop")
    write_pack(tmp_path / "pack", tubers=2, views=1, seed=1)
    with np.load(tmp_path / "pack" / "views-00000.npz") as stored:
        arrays = dict(stored)
    arrays["weight_g"][1] = float(weight)
    np.savez(tmp_path / "pack" / "views-00000.npz", **arrays)
    with pytest.raises(InputError, match=rf"views-00000.npz, view 1: weight_g is {weight}; allowed are grams above 0"):
        load_cloudset(tmp_path / "pack")


@pytest.mark.parametrize("unit", ["kilograms", "belt"])
def test_a_wrong_unit_is_refused(tmp_path: Path, unit: str) -> None:
    """Weights in kilograms trained to the end and were praised: MAE 0.1 g. So did a belt at ten times its distance."""
    write_twin(tmp_path, tubers=3, weights_g=["0.12", "0.2", "0.15"] if unit == "kilograms" else ["120", "200", "150"])
    if unit == "belt":
        table = (tmp_path / "ground_truth.csv").read_text(encoding="utf-8")
        (tmp_path / "ground_truth.csv").write_text(table.replace(",0.42", ",4.2"), encoding="utf-8")
    with pytest.raises(InputError, match=r"median weight of .* allowed are 0\.05 to 20 g a ml\. Check that weights"):
        load_cloudset(tmp_path)


@pytest.mark.parametrize("wrong", ["scale", "belt"])
def test_views_that_weigh_refuses_are_no_data(wrong: str, tmp_path: Path) -> None:
    """A depth scale of 10000 on 1 mm images and a belt at 0.82 m instead of 0.42 were trained on and judged by."""
    write_twin(tmp_path, tubers=3, belt_distance_m=0.82 if wrong == "belt" else 0.42)
    if wrong == "belt":
        table = (tmp_path / "ground_truth.csv").read_text(encoding="utf-8")
        (tmp_path / "ground_truth.csv").write_text(table.replace(",0.82", ",1.22"), encoding="utf-8")
    else:
        (camera,) = (tmp_path / "1_rgbd" / "0_camera_intrinsics").iterdir()
        camera.write_text(camera.read_text(encoding="utf-8").replace("1000", "2000"), encoding="utf-8")
    words = r": 3 of 3 views float above their belt or lie under it.* is 0\.\d+ m from the camera and its belt "
    with pytest.raises(InputError, match=words):
        load_cloudset(tmp_path)
    with pytest.raises(InputError, match=words):
        evaluate(tmp_path, Weigher.load())


def test_a_pair_without_depth_is_left_out_with_its_name(tmp_path: Path) -> None:
    """One depth image of zeros ended a training."""
    labels = write_twin(tmp_path / "crop", tubers=4)
    pairs = [tmp_path / "crop" / "1_rgbd" / "1_image" / label / f"{label}_depth_360.png" for label in labels]
    told = ({"empty_cloud": 1}, {"empty_cloud": "t001_depth_360.png"})
    cv2.imwrite(str(pairs[1]), np.zeros((720, 1280), np.uint16))
    for _ in range(2):  # the second one is read from the cache
        data = load_cloudset(tmp_path / "crop", cache=tmp_path / "cache")
        assert (data.tuber.tolist(), data.refused, data.refused_first) == (["t000", "t002", "t003"], *told)
    result = evaluate(tmp_path / "crop", Weigher.load())
    assert (len(result.weight_g), result.refused, result.refused_first) == (3, *told)
    assert "Refused: empty_cloud 1 (t001_depth_360.png)." in markdown(summary(result), title="crop")
    for path in pairs[2:]:
        cv2.imwrite(str(path), np.zeros((720, 1280), np.uint16))
    with pytest.raises(InputError, match=r"3 of 4 views .*: 't001_depth_360.png' shows no depth of its tuber"):
        load_cloudset(tmp_path / "crop")


def test_a_belt_above_most_tubers_is_refused(tmp_path: Path) -> None:
    """Ten of twelve views were left out as below their belt, and the other two judged the weights."""
    labels = write_twin(tmp_path, tubers=3)
    table = (tmp_path / "ground_truth.csv").read_text(encoding="utf-8").splitlines()
    table[2:] = [row.replace(",0.42", ",0.3") for row in table[2:]]
    (tmp_path / "ground_truth.csv").write_text("\n".join(table), encoding="utf-8")
    words = f": 2 of 3 views float above their belt or lie under it.*: no part of '{labels[1]}' stands above its belt"
    with pytest.raises(InputError, match=words):
        load_cloudset(tmp_path)


def test_one_wrong_belt_distance_is_counted(tmp_path: Path) -> None:
    labels = write_twin(tmp_path, tubers=4)
    table = (tmp_path / "ground_truth.csv").read_text(encoding="utf-8").splitlines()
    table[1] = table[1].replace(",0.42", ",0.82")
    (tmp_path / "ground_truth.csv").write_text("\n".join(table), encoding="utf-8")
    data = load_cloudset(tmp_path)
    assert (data.tuber.tolist(), data.refused) == (labels[1:], {"off_the_belt": 1})
    assert evaluate(tmp_path, Weigher.load()).refused == {"off_the_belt": 1}


def test_one_weight_in_kilograms_is_refused(tmp_path: Path) -> None:
    """The median alone was looked at."""
    write_twin(tmp_path, tubers=4, weights_g=["120", "0.14", "150", "160"])
    words = r"1 of 4 tubers are too light for what is seen of them: 't001' weighs 0\.14, with a visible volume of"
    with pytest.raises(InputError, match=words):
        load_cloudset(tmp_path)
    with pytest.raises(InputError, match=words):
        evaluate(tmp_path, Weigher.load())


def test_one_weight_that_is_none_is_refused(tmp_path: Path) -> None:
    """A tuber of 99999 g was learned from and judged by without a word; others may have their tuber mostly hidden."""
    write_twin(tmp_path / "wrong", tubers=4, weights_g=["120", "99999", "150", "160"])
    words = r"1 of 4 tubers are too heavy for what is seen of them: 't001' weighs 99999, with a visible volume of"
    with pytest.raises(InputError, match=words):
        load_cloudset(tmp_path / "wrong")
    with pytest.raises(InputError, match=words):
        evaluate(tmp_path / "wrong", Weigher.load())
    write_twin(tmp_path / "heavy", tubers=4, weights_g=["120", "1150", "150", "160"])
    assert len(load_cloudset(tmp_path / "heavy")) == 4


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace(",", ";"), r"no column 'label'.* separated by semicolons; save it with commas"),
        (
            lambda text: text.replace(",120,", ',"120,5",'),
            r"'t000' has weight_g_inctack '120,5', which .* with a point",
        ),
        (lambda text: text.replace("weight_g_inctack", "weight"), r"no column 'weight_g_inctack'; it has label,"),
        (
            lambda text: text.replace("t00", "T00"),
            r"no label has .*: 'T000', 'T001', 'T002' in ground_truth.csv, 't000', 't001', 't002' in the folders",
        ),
    ],
)
def test_what_is_wrong_with_a_table_is_said(change: Callable[[str], str], words: str, tmp_path: Path) -> None:
    """Of a missing column, a decimal comma and NaN the same was said: no number there. Of other labels nothing was."""
    write_twin(tmp_path, tubers=3, weights_g=["120", "200", "150"])
    table = tmp_path / "ground_truth.csv"
    table.write_text(change(table.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        load_cloudset(tmp_path)


def test_a_split_without_rows_or_its_column_is_said(tmp_path: Path) -> None:
    write_parts(tmp_path, {})
    with pytest.raises(InputError, match=r"has no split 'val'; known: none: it has no rows"):
        labels_of_split(tmp_path, "val")
    (tmp_path / "splits.csv").write_text("label,part\nt000,val\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"splits.csv has no column 'split'; it has label, part"):
        labels_of_split(tmp_path, "val")


def test_tubers_without_views_are_counted(tmp_path: Path) -> None:
    """Labels that were written otherwise than their folders left the training without a word."""
    labels = write_twin(tmp_path, tubers=4)
    shutil.rmtree(tmp_path / "1_rgbd" / "1_image" / labels[0])
    assert load_cloudset(tmp_path).refused == {"tubers_without_views": 1}
    write_parts(tmp_path, {"train": [labels[1], "other"], "val": ["none"]})
    assert load_cloudset(tmp_path, split="train").refused == {"tubers_without_views": 1}
    with pytest.raises(InputError, match=r"'none' in 'val' of splits.csv, 't000', 't001', 't002', ... in ground_truth"):
        load_cloudset(tmp_path, split="val")


def test_the_test_part_stays_untouched(tmp_path: Path) -> None:
    """With another folder for --val all of a crop was trained on, its test part too; calibrations read all of it."""
    labels = write_twin(tmp_path / "crop", tubers=5)
    write_twin(tmp_path / "other", tubers=2, seed=9)
    write_parts(tmp_path / "crop", {"train": labels[:2], "val": labels[2:3], "test": labels[3:]})
    data, validation = _sets(tmp_path / "crop", tmp_path / "other", tmp_path / "out")
    assert data.tuber.tolist() == labels[:2]
    assert validation.tuber.tolist() == ["t000", "t001"]
    assert _sets(tmp_path / "other", tmp_path / "crop", tmp_path / "out")[1].tuber.tolist() == labels[2:3]
    state, sidecar = load_weights()
    weights = tmp_path / "other-program.safetensors"
    save_file(dict(state), weights)
    before = weights.read_bytes()
    digest = hashlib.sha256(before).hexdigest()
    weights.with_suffix(".json").write_text(sidecar.model_copy(update={"sha256": digest}).model_dump_json())
    found = recalibrate(weights, tmp_path / "crop", cache=None, max_views=None)
    assert found.metrics["calibration"]["tubers"] == 1
    # Saved again by this program they had other bytes, and so another name in the ledger.
    assert (weights.read_bytes(), found.sha256) == (before, digest)


def test_weights_know_how_far_below_the_belt_their_tubers_lay(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`evaluate` read the tubers 5.5 mm below their belt and said -0.3 %, `weigh` on it and said -9.7 %."""
    write_twin(tmp_path / "crop", tubers=24, more={"resting_offset_mm": ["3"] * 24, "resting_sd_mm": ["1"] * 24})
    write_twin(tmp_path / "other", tubers=4, seed=9)
    (view, *_) = read_labelled(tmp_path / "crop")
    assert (view.resting_offset_m, view.resting_sd_m) == (0.003, 0.001)
    options = RunOptions(tmp_path / "crop", tmp_path / "other", tmp_path / "out", "x", False, 9.0, 9.0, 200, "train")
    settings = TrainSettings(epochs=1.0, batch=8)
    sidecar = train(
        options, settings, on_prepared=lambda *_: None, on_step=lambda _: None, on_validated=lambda *_: None
    )
    assert sidecar.training["resting"] == {"offset_mm": 3.0, "sd_mm": 1.0, "source": "stated"}
    tell_trained_resting(sidecar)
    assert "--resting-offset-mm 3 --resting-sd-mm 1;" in capsys.readouterr().err
    tell_trained_resting(load_weights()[1])
    assert capsys.readouterr().err == ""


def test_a_pack_has_no_split(tmp_path: Path) -> None:
    """`evaluate --split test` of a pack judged on all of it, the views of the training included."""
    write_pack(tmp_path / "pack", tubers=2, views=1, seed=1)
    with pytest.raises(InputError, match="is a view pack and has no split 'test'"):
        evaluate(tmp_path / "pack", Weigher.load(), split="test")
    with pytest.raises(InputError, match="give a pack of its own for each part"):
        _sets(tmp_path / "pack", tmp_path / "pack", tmp_path / "out")


def test_a_network_that_fails_is_judged_by_its_own_answers(tmp_path: Path) -> None:
    """Where its answer was not believed, the row 'PointRAFT' had the volume rule's: a network that says -1900 g of
    every tuber was told to err by 11 g.
    """
    write_pack(tmp_path / "pack", tubers=6, views=1, seed=1)
    state, sidecar = load_weights()
    state["regression_head.lins.2.bias"] = state["regression_head.lins.2.bias"] - 2000
    result = evaluate(tmp_path / "pack", Weigher(state, sidecar))
    assert result.flags["network_failed"] == 6
    scores = method_scores(result)
    assert scores[NETWORK]["mae_g"] > 1900
    assert scores[VOLUME_RULE]["mae_g"] < 50


def test_views_without_the_target_are_refused_and_counted(tmp_path: Path) -> None:
    """One tuber without a volume made every figure of weights for volumes NaN, and metrics.json no JSON."""
    volumes = ["", *(["120"] * 6)]
    write_twin(tmp_path / "crop", tubers=7, more={"volume_metashape": volumes})
    state, sidecar = load_weights()
    weigher = Weigher(state, sidecar.model_copy(update={"target": "volume_ml"}))
    result = evaluate(tmp_path / "crop", weigher)
    assert result.refused == {"no_volume_ml": 1}
    assert result.weight_g.tolist() == [120.0] * 6
    json.dumps(summary(result), allow_nan=False)


def test_what_no_part_has_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A label that splits.csv lacks, or an image whose depth was lost, left trainings without a word."""
    labels = write_twin(tmp_path / "crop", tubers=4)
    tell_twin(tmp_path / "crop")
    write_parts(tmp_path / "crop", {"train": labels[:2], "val": labels[2:3]})
    (tmp_path / "crop" / "1_rgbd" / "1_image" / "t000" / "t000_depth_360.png").unlink()
    assert capsys.readouterr().err == ""
    tell_twin(tmp_path / "crop", tmp_path / "crop", tmp_path)
    assert capsys.readouterr().err == (
        f"{tmp_path / 'crop'}: left out: 1 label of ground_truth.csv in no part of splits.csv ('t003'); 1 label of "
        "ground_truth.csv without depth images and clouds ('t000'): a label is written alike in tables and folders; "
        "1 colour image without a depth image of the name ('t000_rgb_360.png')\n"
    )


def test_labels_of_a_table_or_a_folder_alone_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`evaluate` judged the tubers that were left, and did not tell of one whose images were missing."""
    folder = tmp_path / "crop"
    labels = write_twin(folder, tubers=6)
    write_parts(folder, {"train": labels[:4], "val": [labels[4], "typo"]})
    images = folder / "1_rgbd" / "1_image"
    shutil.rmtree(images / "t001")
    (images / "t004").rename(images / "T004")
    table = folder / "ground_truth.csv"
    rows = table.read_text(encoding="utf-8").splitlines(keepends=True)
    table.write_text("".join(row for row in rows if not row.startswith("t005")), encoding="utf-8")
    evaluate_command(data=folder, out=tmp_path / "out", plots=False)
    assert (
        f"{folder}: left out: 2 labels of ground_truth.csv without depth images and clouds ('t001', 't004'); 1 label "
        "of splits.csv without a row in ground_truth.csv ('typo'); 2 labels of images or clouds without a row in "
        "ground_truth.csv ('T004', 't005'): a label is written alike in tables and folders\n"
    ) in capsys.readouterr().err


def test_a_split_tells_which_of_its_labels_have_no_views(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_twin(tmp_path, tubers=30)
    shutil.rmtree(tmp_path / "1_rgbd" / "1_image" / "t007")
    split_command(tmp_path)
    assert "1 label of ground_truth.csv without depth images and clouds ('t007')" in capsys.readouterr().err


def test_the_views_of_a_training_calibrate_no_interval(tmp_path: Path) -> None:
    """A network answers them too well: intervals came out half as wide."""
    write_pack(tmp_path / "pack", tubers=24, views=1, seed=1)
    model, sidecar = load_checkpoint()
    learned = {**sidecar.training, "data": digest_of(load_cloudset(tmp_path / "pack"))}
    path = tmp_path / "w.safetensors"
    save_checkpoint(path, model.state_dict(), sidecar.model_copy(update={"training": learned}))
    with pytest.raises(InputError, match=r"pack is what .* were trained on"):
        recalibrate(path, tmp_path / "pack", cache=None, max_views=None)
    write_pack(tmp_path / "fresh", tubers=24, views=1, seed=2)
    assert recalibrate(path, tmp_path / "fresh", cache=None, max_views=None).metrics["interval"]["tubers"] == 24
