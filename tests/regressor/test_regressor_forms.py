"""A network answers the same whoever asks it: a training, a calibration, `weigh` or a line."""

from __future__ import annotations

import copy
import csv
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from regressor.network.checkpoint import load_checkpoint, read_checkpoint, save_checkpoint, state_of
from regressor.network.fast import Form
from regressor.network.grouped import gathered_forward
from regressor.network.grouping import GatheredGroups, SharedGroups, group_prefix, group_sampled
from regressor.network.pointnet import PointNet
from regressor.network.pointraft import PointRaft
from regressor.network.sampling import farthest_points
from regressor.network.sidecar import Sidecar, StartPolicy
from regressor.network.stored import SHIPPED
from regressor.studies.evaluate import NETWORK, evaluate
from regressor.training import cloudset
from regressor.training.answers import answers, asked_while_read
from regressor.training.augment import Augmentation
from regressor.training.calibration import recalibrate
from regressor.training.cloudset import load_cloudset
from regressor.training.labelled import read_labelled
from regressor.training.recipe import TrainSettings
from regressor.training.run import RunOptions, train
from regressor.training.train import SWIFT, Training, predict
from regressor.weigh.weigher import Weigher
from tests.regressor.ellipsoids import write_pack
from tests.regressor.training_step import check_same_step, readable_in_training

LONG_M = (0.15, 0.035, 0.03)
"""Half axes of fruits that are wider than the smaller search radius."""


def weighed_alone(weigher: Weigher, folder: Path) -> NDArray[np.float64]:
    """(n,) grams of the network alone, as `weigh` has them."""
    return np.array([weigher.network_g(view.prepare()) for view in read_labelled(folder)])


def imported(folder: Path) -> tuple[PointRaft, Sidecar]:
    """The shipped tensors as `import-checkpoint` takes a checkpoint over, in `folder`."""
    model, _ = load_checkpoint()
    save_checkpoint(folder / "w.safetensors", model.state_dict(), Sidecar(name="w", start=StartPolicy(kind="random")))
    return load_checkpoint(folder / "w.safetensors")


@pytest.mark.parametrize("half_axes_m", [(0.04, 0.032, 0.027), (0.016, 0.013, 0.011), LONG_M])
def test_an_imported_network_is_calibrated_by_what_it_weighs(
    half_axes_m: tuple[float, float, float], tmp_path: Path
) -> None:
    """Calibrations predicted from the points of a sampling that starts at the first one; `weigh` starts at random,
    and takes the points of small clouds as they come. Single views were up to 26 g apart.
    """
    write_pack(tmp_path / "pack", tubers=8, views=1, seed=3, half_axes_m=half_axes_m)
    model, sidecar = imported(tmp_path)
    asked = asked_while_read(model, sidecar, compute=None)
    for _ in ("prepared", "from the cache"):
        views = load_cloudset(tmp_path / "pack", cache=tmp_path / "cache", asked=asked)
        found_g = answers(model, sidecar, views)
        swift = Weigher(state_of(model), sidecar, Form(centroids=SWIFT.centroids))
        assert found_g == pytest.approx(weighed_alone(swift, tmp_path / "pack"), rel=1e-6)
    assert np.abs(found_g - predict(model, views, highest_m=sidecar.input.max_height_m)).max() > 0.5
    sidecar = recalibrate(tmp_path / "w.safetensors", tmp_path / "pack", cache=tmp_path / "cache", max_views=None)
    judged = evaluate(tmp_path / "pack", Weigher.load(tmp_path / "w.safetensors"))
    mae_g = float(np.abs(judged.predicted[NETWORK] - judged.weight_g).mean())
    assert sidecar.metrics["calibration"]["mae_g"] == pytest.approx(mae_g, abs=0.3)
    other = asked_while_read(
        model, sidecar.model_copy(update={"start": StartPolicy(kind="random", seed=1)}), compute=None
    )
    assert asked is not None
    assert other is not None
    assert asked.name != other.name


@pytest.mark.parametrize("half_axes_m", [(0.04, 0.032, 0.027), (0.011, 0.009, 0.008), LONG_M])
def test_a_prediction_is_what_is_weighed(half_axes_m: tuple[float, float, float], tmp_path: Path) -> None:
    """Clouds wider than 0.2 m were trained and calibrated as if every centroid had the same neighbours, and weighed in
    the general form; small clouds with more centroids than they are weighed with.
    """
    write_pack(tmp_path, tubers=8, views=1, seed=4, half_axes_m=half_axes_m)
    weigher = Weigher.load()
    model, sidecar = load_checkpoint()
    views = load_cloudset(tmp_path)
    forms = {type(group_prefix(view.prepare().points)) for view in read_labelled(tmp_path)}
    assert (GatheredGroups in forms) == (half_axes_m is LONG_M)
    found_g = predict(model, views, highest_m=sidecar.input.max_height_m)
    assert found_g == pytest.approx(weighed_alone(weigher, tmp_path), rel=1e-5, abs=1e-3)


def test_a_step_trains_on_what_is_weighed(tmp_path: Path) -> None:
    """One step on long fruits, as they are: its loss is that of what the weigher says of them."""
    write_pack(tmp_path, tubers=8, views=1, seed=5, half_axes_m=LONG_M)
    data = load_cloudset(tmp_path)
    as_it_is = Augmentation(0.0, 0.0, 0.0, flip=False, plane_shear=0.0, scale=0.0)
    settings = replace(TrainSettings.fine_tuning(), batch=8, wide_share=0.0, augmentation=as_it_is, max_height_m=0.16)
    training = Training(data, data, settings)
    training.start_from(read_checkpoint(SHIPPED)[0])
    rows = np.random.default_rng(settings.seed).choice(len(data), settings.batch)
    weighed_g = torch.from_numpy(weighed_alone(Weigher.load(), tmp_path)[rows])
    truth_g = torch.from_numpy(data.weight_g[rows])
    expected = torch.nn.functional.smooth_l1_loss(weighed_g, truth_g, beta=settings.beta_g)
    assert training.step() == pytest.approx(float(expected), rel=1e-4)


def test_the_general_form_equals_the_readable_network_in_training() -> None:
    """Clouds of 128 points, 0.24 m long: 64 centroids that the second stage reads all, each with 64 neighbours or more
    in its radius, so both forms see the same edges and the same statistics.
    """
    readable = readable_in_training()
    general = copy.deepcopy(readable)
    rng = np.random.default_rng(0)
    clouds = [((rng.random((128, 3)) - 0.5) * [0.24, 0.03, 0.02]).astype(np.float32) for _ in range(4)]
    clouds = [cloud[farthest_points(cloud, 128)] for cloud in clouds]
    heights = torch.from_numpy(rng.uniform(0.02, 0.08, 4))
    groups = [group_sampled(cloud, of=128) for cloud in clouds]
    doubled = [
        replace(
            group,
            points=group.points.astype(np.float64),
            centroids1=group.centroids1.astype(np.float64),
            centroids2=group.centroids2.astype(np.float64),
        )
        for group in groups
        if isinstance(group, GatheredGroups)
    ]
    assert len(doubled) == 4
    expected = readable([torch.from_numpy(cloud).double() for cloud in clouds], heights)
    found = gathered_forward(general, doubled, heights)
    check_same_step(readable, expected, general, found)


def test_the_readable_network_runs_where_its_tensors_are() -> None:
    """Sampling asked a GPU's tensor for its NumPy array, which it does not have."""
    if not torch.cuda.is_available():
        pytest.skip("no CUDA GPU here: the readable network was NOT run on one")
    model = load_checkpoint()[0]
    cloud, height_m = torch.randn(300, 3) * 0.02, torch.tensor([0.05])
    with torch.inference_mode():
        here = float(model([cloud], height_m))
        there = float(model.to("cuda")([cloud.to("cuda")], height_m.to("cuda")))
    assert there == pytest.approx(here, rel=1e-4)


def test_a_cloud_that_no_radius_binds_keeps_the_shared_form() -> None:
    rng = np.random.default_rng(1)
    cloud = (rng.normal(size=(2000, 3)) * 0.02).astype(np.float32)
    first = cloud[farthest_points(cloud, cloudset.KEEP)]
    whole, kept = group_prefix(cloud), group_sampled(first, of=len(cloud))
    assert isinstance(whole, SharedGroups)
    assert isinstance(kept, SharedGroups)
    for name in ("neighbours", "centroids1", "centroids2"):
        assert np.array_equal(getattr(whole, name), getattr(kept, name))


def test_trainings_that_share_a_cache_do_not_break_it(tmp_path: Path) -> None:
    """All wrote one file under one partial name: the second one to finish found it gone, or read half of another's."""
    write_pack(tmp_path / "pack", tubers=3, views=1, seed=5)
    data = load_cloudset(tmp_path / "pack", cache=tmp_path / "cache")
    (file,) = (tmp_path / "cache").iterdir()
    with ThreadPoolExecutor(4) as pool:
        for _ in pool.map(lambda _: cloudset._write_cache(file, data), range(40)):
            assert np.array_equal(load_cloudset(tmp_path / "pack", cache=tmp_path / "cache").points, data.points)
    assert [path.name for path in (tmp_path / "cache").iterdir()] == [file.name]


def test_a_broken_cache_is_made_again(tmp_path: Path) -> None:
    """One that was cut short by a power cut ended each training with a traceback, until someone deleted it."""
    write_pack(tmp_path / "pack", tubers=3, views=1, seed=5)
    data = load_cloudset(tmp_path / "pack", cache=tmp_path / "cache")
    (file,) = (tmp_path / "cache").iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    assert np.array_equal(load_cloudset(tmp_path / "pack", cache=tmp_path / "cache").points, data.points)
    assert file.stat().st_size == len(whole)


def test_the_paper_s_recipe_keeps_its_best_epoch(tmp_path: Path) -> None:
    """It wrote the last epoch; the authors' code keeps the one with the least validation loss."""
    write_pack(tmp_path / "train", tubers=8, views=1, seed=1)
    write_pack(tmp_path / "val", tubers=4, views=1, seed=2)
    out = tmp_path / "out"
    settings = replace(TrainSettings.paper(), epochs=4.0, batch=4, lr=0.02)
    options = RunOptions(tmp_path / "train", tmp_path / "val", out, "x", False, 9.0, 9.0, 20, "tuberline train")
    told: list[int] = []
    sidecar = train(
        options,
        settings,
        on_prepared=lambda what, done: None,
        on_step=lambda training: None,
        on_validated=lambda training, metrics: told.append(training.progress.step),
    )
    assert told == [2, 4, 6, 8]
    with (out / "log.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    best = min(rows, key=lambda row: float(row["val_loss"]))
    assert sidecar.training["steps"] == int(best["step"])
    model, kept = load_checkpoint(out / "weights.safetensors")
    assert kept == sidecar
    found_g = predict(model, load_cloudset(tmp_path / "val"), highest_m=kept.input.max_height_m)
    assert float(np.abs(found_g - load_cloudset(tmp_path / "val").weight_g).mean()) == pytest.approx(
        float(best["val_mae_g"]), rel=1e-3
    )
    assert (out / "latest.safetensors").is_file()


def test_pointnet_sees_a_set_and_no_more() -> None:
    """The order of the points, their repetition and the batch around a cloud change nothing; one more point may."""
    torch.manual_seed(2)
    model = PointNet().eval()
    cloud = torch.randn(1, 300, 3) * 0.02
    with torch.inference_mode():
        expected = float(model(cloud))
        assert float(model(cloud.flip(1))) == pytest.approx(expected, rel=1e-6)
        assert float(model(torch.cat([cloud, cloud[:, :50]], dim=1))) == pytest.approx(expected, rel=1e-6)
        assert float(model(torch.cat([cloud, torch.randn(1, 300, 3)]))[0]) == pytest.approx(expected, rel=1e-6)
        assert float(model(torch.cat([cloud, torch.full((1, 1, 3), 0.5)], dim=1))) != expected
