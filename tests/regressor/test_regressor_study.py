"""Around a training: splits, the search for a recipe, drift and the page of results."""

from __future__ import annotations

import csv
import json
import resource
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from conveyor.errors import InputError
from regressor.studies import drift as drifting
from regressor.studies.ablate import COLUMNS, RULES, VARIANTS, read_table, write_table
from regressor.studies.drift import SHIFTS, drift, write_drift
from regressor.studies.evaluate import LINEAR_BOX, NETWORK, SHIPPED, evaluate
from regressor.studies.page import evaluation_page
from regressor.studies.report import write_plots, write_report
from regressor.studies.search import SEARCHED, search
from regressor.training.cloudset import load_cloudset
from regressor.training.labelled import read_labelled
from regressor.training.recipe import TrainSettings, recipe_named
from regressor.training.split import stratified_split, write_splits
from regressor.training.train import Training
from regressor.weigh.weigher import Weigher
from tests.regressor.ellipsoids import D405, ellipsoid_depth_m, write_pack
from tests.regressor.twin_folder import write_parts, write_twin
from tuberline.cli.ablate import ablate as ablate_command
from tuberline.cli.drift import drift as drift_command
from tuberline.cli.evaluate import evaluate as evaluate_command
from tuberline.cli.search import search as search_command
from tuberline.cli.search import trial_table


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study") / "pack"
    write_pack(folder, tubers=12, views=1, seed=8)
    return folder


def test_a_split_shares_out_every_weight_class(rng: np.random.Generator) -> None:
    weights = rng.gamma(2.4, 70, 859)
    part = stratified_split(weights)
    assert [int((part == name).sum()) for name in ("train", "val", "test")] == [515, 172, 172]
    decile = np.argsort(np.argsort(weights)) * 10 // len(weights)
    for which in range(10):
        assert (part[decile == which] == "train").mean() == pytest.approx(0.6, abs=0.03)
        assert (part[decile == which] == "test").mean() == pytest.approx(0.2, abs=0.03)
    assert np.array_equal(part, stratified_split(weights))
    assert not np.array_equal(part, stratified_split(weights, seed=21))


def test_splits_are_written_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"ground_truth.csv cannot be read"):
        write_splits(tmp_path)
    rows = "\n".join(f"T{i},{50 + 3 * i}" for i in range(60))
    (tmp_path / "ground_truth.csv").write_text(f"label,weight_g_inctack\n{rows}\n", encoding="utf-8")
    assert write_splits(tmp_path) == {"train": 36, "val": 12, "test": 12}
    with (tmp_path / "splits.csv").open(newline="", encoding="utf-8") as file:
        written = {row["label"]: row["split"] for row in csv.DictReader(file)}
    assert len(written) == 60
    with pytest.raises(InputError, match="--force"):
        write_splits(tmp_path)
    (tmp_path / "ground_truth.csv").write_text("label,weight_g_inctack\nT1,heavy\n", encoding="utf-8")
    with pytest.raises(InputError, match="'heavy', which is no number of grams"):
        write_splits(tmp_path, force=True)


def test_ablations_and_searches_say_which_views_they_leave_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`train` and `evaluate` did; a table and a recipe rested on fewer views than one thought."""
    for folder in ("val", "train/same"):
        write_pack(tmp_path / folder, tubers=3, views=1, seed=2)
    write_pack(tmp_path / "train/more", tubers=64, views=1, seed=1)
    data: dict[str, Any] = {"data": tmp_path / "train", "val": tmp_path / "val", "epochs": 0.5}
    ablate_command("pointnet", **data, test=tmp_path / "val", out=tmp_path / "ablation")
    assert "training views left out: in_validation 3\n" in capsys.readouterr().err
    search_command(**data, out=tmp_path / "search", trials=1)
    assert "training views left out: in_validation 3\n" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["ablate", "search"])
def test_studies_that_are_refused_leave_no_folder(pack: Path, tmp_path: Path, command: str) -> None:
    """Prepared validation views stayed behind, of a study that never began."""
    write_twin(tmp_path / "crop", tubers=32, weights_g=["0.12"] * 32)
    data: dict[str, Any] = {"data": tmp_path / "crop", "val": pack, "out": tmp_path / "out"}
    ways = {"ablate": lambda: ablate_command("pointnet", **data, test=pack), "search": lambda: search_command(**data)}
    with pytest.raises(InputError, match=r"crop: a median weight of 0.12"):
        ways[command]()
    assert not (tmp_path / "out").exists()


def test_a_search_goes_on_where_it_was(pack: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    optuna = pytest.importorskip("optuna")
    optuna.logging.enable_propagation()
    data = load_cloudset(pack)
    settings = TrainSettings(epochs=0.3, warm_share=1.0, wide_share=0.0)
    settings = replace(settings, average=0.0)
    large = data.subset(np.resize(np.arange(len(data)), 64))
    first = search(large, data, settings, storage=tmp_path / "search.db", trials=1)
    rows = search(large, data, settings, storage=tmp_path / "search.db", trials=2)
    assert [row["trial"] for row in first] == [0]
    assert sorted(row["trial"] for row in rows) == [0, 1]
    assert first[0] in rows
    assert rows[0]["val_mae_g"] <= rows[1]["val_mae_g"]
    assert rows[0]["batch"] in (16, 32, 64)
    assert search(large, data, settings, storage=tmp_path / "search.db", trials=2) == rows
    with pytest.raises(InputError, match=r"begun otherwise: epochs 0.3, now 0.6\. Trials are compared"):
        # Trials of other lengths were ranked in one table, and taught the sampler.
        search(large, data, replace(settings, epochs=0.6), storage=tmp_path / "search.db", trials=3)
    with pytest.raises(InputError, match="12 training views are fewer than the largest batch that is tried, 64"):
        # Optuna told it with a traceback, and not before a trial drew that batch.
        search(data, data, settings, storage=tmp_path / "small.db", trials=1)
    (tmp_path / "notes.db").write_text("no database")
    with pytest.raises(InputError, match=r"notes.db holds no search: .* Take it away, or give another --out"):
        search(large, data, settings, storage=tmp_path / "notes.db", trials=1)
    with pytest.raises(InputError, match="validation views"):
        search(large, large, settings, storage=tmp_path / "search.db", trials=3)

    def diverging(number: int, training: Training) -> None:
        with torch.no_grad():
            training.model.regression_head.lins[-1].bias.fill_(np.nan)  # type: ignore[operator, union-attr]

    # It ended the search, and each next call was another trial of it.
    *finished, failed = search(large, data, settings, storage=tmp_path / "search.db", trials=3, on_step=diverging)
    assert finished == rows
    assert (failed["trial"], failed["val_mae_g"]) == (2, None)
    assert "is no number" in failed["failed"] or "answers no number" in failed["failed"]
    assert set(SEARCHED) < set(failed)
    told = list(trial_table([*finished, failed]).columns[1].cells)
    assert told == [*(f"{row['val_mae_g']:.2f}" for row in rows), "failed"]

    def stopped(number: int, training: Training) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search(large, data, settings, storage=tmp_path / "search.db", trials=4, on_step=stopped)
    assert not caplog.records, "Ctrl-C was told with a traceback"


def test_shifts_do_what_they_say(pack: Path, rng: np.random.Generator) -> None:
    view = next(read_labelled(pack))
    nearer = SHIFTS["belt 3 mm nearer than believed"](view, rng)
    assert nearer is not None
    assert nearer.belt_distance_m == pytest.approx(view.belt_distance_m + 0.003)
    noisy = SHIFTS["noise x3"](view, rng)
    assert noisy is not None
    assert noisy.depth is not None
    assert view.depth is not None
    assert np.array_equal(noisy.depth > 0, view.depth > 0)
    added_m = (noisy.depth.astype(float) - view.depth)[view.depth > 0] * view.depth_scale_m
    at_m = float(np.median(view.depth[view.depth > 0])) * view.depth_scale_m
    assert added_m.std() == pytest.approx(np.sqrt(8) * 0.06 * at_m**2 / (view.fx * 0.018), rel=0.35)
    assert SHIFTS["only 2025 (knobby)"](view, rng) is None


def test_drift_reports_the_bias_of_the_total(pack: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = ("as it is", "belt 6 mm nearer than believed", "only Sayaka")
    monkeypatch.setattr(drifting, "SHIFTS", {name: SHIFTS[name] for name in chosen})
    weigher = Weigher.load()
    told: list[tuple[str, int, int | None]] = []
    measured = drift(pack, {"the same again": pack}, weigher, max_views=12, on_work=lambda *said: told.append(said))
    done = [n for _, n, _ in told]
    assert done == sorted(done)
    assert {of for _, _, of in told} == {12 * (len(chosen) + 1)}
    assert list(measured["shifts"]) == ["as it is", "belt 6 mm nearer than believed", "the same again"]
    assert measured["left_out"] == {"only Sayaka": 0}
    assert drifting.markdown(measured).endswith("for fewer than 10: only Sayaka (0).\n"), "it left without a word"
    for also, words in (("=x", "is NAME=FOLDER"), ("as it is=x", "has a row 'as it is' already")):
        with pytest.raises(InputError, match=f"--also {also}: .*{words}"):
            drift_command(data=pack, out=tmp_path / "drift", also=[also])
    plain, tall = (measured["shifts"][name]["methods"][SHIPPED] for name in chosen[:2])
    assert measured["shifts"]["the same again"]["methods"][SHIPPED] == plain
    # Six millimetres are a tenth of a tuber's height.
    assert 5 < tall["total_bias_percent"] - plain["total_bias_percent"] < 30
    with pytest.raises(InputError, match=r"holds no view of season 1999; it has views of 2026"):
        evaluate(pack, weigher, season="1999")
    result = evaluate(pack, weigher)
    write_report(result, tmp_path / "evaluation", title="x")
    text = write_drift(measured, tmp_path / "drift")
    assert f"| as it is | 12 | {plain['mae_g']:.1f}" in text
    row = dict.fromkeys(("mae_g", "rmse_g", "bias_g", "r2", "tuber_mae_g", "load_bias_percent"), 1.0)
    table = {"full": {**row, "steps": 7.0}, **dict.fromkeys(RULES, row)}
    (tmp_path / "ablation.json").write_text(json.dumps({"recipe": "R.", "table": table}), encoding="utf-8")
    folder = tmp_path / "evaluation"
    page = evaluation_page(
        folder, folder, one_season=folder, ablation=tmp_path, drift=tmp_path / "drift", speed=None, image="a.png"
    )
    assert page.count("\n## field\n") == page.count("\n## Field, one season\n") == 1
    assert f"| {NETWORK} | " in page
    assert "| full: PointRAFT | 7 | 1.000 |" in page
    assert text.strip() in page
    with pytest.raises(InputError, match=r"speed.md cannot be read"):
        evaluation_page(folder, folder, ablation=None, drift=None, speed=tmp_path, image=None)


def test_drift_reads_the_test_part_alone(tmp_path: Path) -> None:
    """It weighed all of a folder with a splits.csv, the tubers of its training too."""
    labels = write_twin(tmp_path, tubers=14)
    write_parts(tmp_path, {"train": labels[:3], "val": labels[3:4], "test": labels[4:]})
    seen: set[int | None] = set()
    said: list[str] = []
    measured = drift(
        tmp_path, {"again": tmp_path}, Weigher.load(), max_views=None, on_work=lambda words, done, of: seen.add(of)
    )
    assert measured["shifts"]["as it is"]["methods"][SHIPPED]["views"] == 10
    assert measured["shifts"]["again"]["methods"][SHIPPED]["views"] == 10
    assert seen == {10 * (len(SHIFTS) + 1)}
    write_parts(tmp_path, {"train": labels[:5], "test": labels[5:]})
    with pytest.raises(InputError, match=r"holds fewer than 10 tubers: nothing can be said"):
        drift(tmp_path, {}, Weigher.load(), max_views=None, on_work=lambda words, done, of: said.append(words))
    assert said == ["as it is"], "each shift was read to find that"
    with pytest.raises(InputError, match=r"the first 1 views of .* are of fewer than 10 tubers"):
        drift(tmp_path, {}, Weigher.load(), max_views=1)
    with pytest.raises(InputError, match=r"holds fewer than 10 tubers: nothing can be said"):
        drift(tmp_path, {}, Weigher.load(), max_views=600)
    with pytest.raises(InputError, match=r"ground_truth\.csv is a file: give the folder that it is in"):
        evaluate(tmp_path / "ground_truth.csv", Weigher.load())


def test_noise_is_added_to_images_alone(pack: Path, rng: np.random.Generator) -> None:
    """One shift that a set of clouds cannot take ended the command, after five others were weighed."""
    view = next(read_labelled(pack))
    cloud = replace(view, depth=None, cloud=np.zeros((40, 3)))
    assert SHIFTS["noise x2"](cloud, rng) is None
    assert SHIFTS["belt 3 mm nearer than believed"](cloud, rng) is not None


def test_another_crop_in_the_same_layout(tmp_path: Path) -> None:
    """Apples, nearly round, seen from 0.42 m in a season of their own: docs/pointraft.md, another crop."""
    images = tmp_path / "1_rgbd" / "1_image"
    intrinsics = tmp_path / "1_rgbd" / "0_camera_intrinsics" / "camera_intrinsic.json"
    intrinsics.parent.mkdir(parents=True)
    matrix = [D405.fx, 0, 0, 0, D405.fy, 0, D405.cx, D405.cy, 1]
    intrinsics.write_text(json.dumps({"width": 1280, "height": 720, "intrinsic_matrix": matrix, "depth_scale": 1000}))
    rows = ["label,growing_season,cultivar,weight_g_inctack,belt_distance_m"]
    for number, radius_m in enumerate((0.033, 0.037, 0.041)):
        name = f"apple{number}"
        depth_m = ellipsoid_depth_m((radius_m, radius_m, 0.93 * radius_m), belt_distance_m=0.42)
        (images / name).mkdir(parents=True)
        cv2.imwrite(str(images / name / f"{name}_depth_360.png"), np.round(1000 * depth_m).astype(np.uint16))
        mask = np.zeros((720, 1280, 4), np.uint8)
        mask[..., 3] = 255 * (depth_m > 0)
        cv2.imwrite(str(images / name / f"{name}_rgb_360.png"), mask)
        rows.append(f"{name},2026,Elstar,{0.85e6 * 4 / 3 * np.pi * 0.93 * radius_m**3:.1f},0.42")
    (tmp_path / "ground_truth.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    apples = load_cloudset(tmp_path)
    assert apples.weight_g == pytest.approx([119.0, 167.7, 228.2], abs=0.1)
    assert apples.belt_distance_m == pytest.approx([0.42] * 3)
    assert apples.height_m == pytest.approx([2 * 0.93 * r for r in (0.033, 0.037, 0.041)], abs=0.002)
    (tmp_path / "ground_truth.csv").write_text("\n".join(row.rpartition(",")[0] for row in rows), encoding="utf-8")
    with pytest.raises(InputError, match="column belt_distance_m"):
        load_cloudset(tmp_path)


def test_one_tuber_is_evaluated_without_baselines(tmp_path: Path) -> None:
    """Baselines fitted on no tuber wrote NaN into metrics.json, which no other program reads."""
    write_pack(tmp_path / "one", tubers=1, views=2, seed=3)
    measured = write_report(evaluate(tmp_path / "one", Weigher.load()), tmp_path / "out", title="One")
    assert LINEAR_BOX not in measured["methods"]
    told = (tmp_path / "out" / "metrics.json").read_text(encoding="utf-8")
    assert json.loads(told, parse_constant=pytest.fail) == measured
    assert "Baselines are left out" in (tmp_path / "out" / "report.md").read_text(encoding="utf-8")


def test_a_plot_of_few_tubers_is_quiet(tmp_path: Path) -> None:
    """Weight classes without a tuber were told to the user as four lines of NumPy's warnings."""
    pytest.importorskip("matplotlib")
    write_pack(tmp_path / "few", tubers=3, views=1, seed=3)
    result = evaluate(tmp_path / "few", Weigher.load())
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        (path,) = write_plots(result, tmp_path)
    assert path.stat().st_size > 10_000


@pytest.mark.parametrize(("option", "value"), [("batch", 0), ("minutes", 0.0), ("epochs", -1.0), ("lr", np.nan)])
def test_a_recipe_without_any_training_is_refused(option: str, value: float) -> None:
    with pytest.raises(InputError, match=f"--{option} is .*must be above 0"):
        recipe_named("tuberline", shear=None, **{option: value})


def test_batch_norm_needs_two_clouds_unless_it_learns_nothing() -> None:
    """A training with --batch 1 ended in torch, after all views were prepared."""
    with pytest.raises(InputError, match="--batch is 1; at least 2 clouds"):
        recipe_named("tuberline", shear=None, batch=1)
    assert recipe_named("fine-tune", shear=None, batch=1).batch == 1


def test_a_table_that_cannot_be_written_leaves_the_former_one(tmp_path: Path) -> None:
    """Half a table was left of hours of training, and `ablate` could not read it."""
    figures = dict.fromkeys(COLUMNS, 1.0)
    write_table(tmp_path, {"full": figures}, "two epochs")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, limits[1]))
    try:
        with pytest.raises(InputError, match=r"ablation.json cannot be written: File too large"):
            write_table(tmp_path, dict.fromkeys(VARIANTS, figures), "three epochs")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert read_table(tmp_path) == ({"full": figures}, "two epochs")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ablation.json", "ablation.md"]


@pytest.mark.parametrize("command", [evaluate_command, drift_command])
def test_a_place_that_cannot_be_written_is_told_before_views_are_weighed(
    pack: Path, tmp_path: Path, command: Callable[..., None]
) -> None:
    """It was told after all of them, an hour or more for 26,600 views."""
    (tmp_path / "file").write_text("no folder")
    for out in (tmp_path / "file", tmp_path / "file" / "results"):
        with pytest.raises(InputError, match=r"--out .*file.* cannot be made: .*a file lies where a folder is needed"):
            command(data=pack, out=out, weights=tmp_path / "read later")
    with pytest.raises(InputError, match="read later cannot be read"):
        command(data=pack, out=tmp_path / "new" / "results", weights=tmp_path / "read later")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
