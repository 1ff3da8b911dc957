"""PointRAFT against the conformance data: the upstream class with its own CUDA kernels, run once elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from regressor.network import affine
from regressor.network.checkpoint import load_checkpoint, state_of
from regressor.network.edges import live_units
from regressor.network.fast import FastPointRaft, Form
from regressor.network.grouping import GatheredGroups, group_given, group_prefix
from regressor.network.pointraft import PointRaft
from regressor.network.sampling import farthest_points, first_in_range

NAMES = [
    "c00_n80",
    "c01_n127",
    "c02_n128",
    "c03_n333",
    "c04_n700",
    "c05_n1024",
    "c06_n1025",
    "c07_n2500",
    "c08_n5000",
    "c09_n6000_tall",
    "c10_n3000_wide030",
    "c11_n900_wide060",
    "c12_n2600_mm_ties",
    "c13_n200_below_belt",
    "c14_n300_strays",
    "c15_n40",
]
WIDE = {"c10_n3000_wide030", "c11_n900_wide060", "c14_n300_strays"}
FIRST_TIE = 53


@pytest.fixture(scope="module")
def clouds(shared: Path) -> dict[str, NDArray[np.generic]]:
    with np.load(shared / "fixtures" / "clouds.npz") as file:
        return {name: file[name] for name in file.files}


@pytest.fixture(scope="module")
def model(shared: Path) -> PointRaft:
    return load_checkpoint(shared / "fixtures" / "pointraft_fixture.safetensors")[0]


def _height(clouds: dict[str, NDArray[np.generic]], name: str) -> float:
    return float(clouds[f"{name}/height"])


def test_upstream_pth_and_safetensors_load_unchanged(shared: Path) -> None:
    upstream = torch.load(shared / "fixtures" / "pointraft_fixture.pth", map_location="cpu", weights_only=True)
    for ending in ("pth", "safetensors"):
        state = load_checkpoint(shared / "fixtures" / f"pointraft_fixture.{ending}")[0].state_dict()
        assert list(state) == list(upstream)
        assert len(state) == 63
        assert all(torch.equal(state[name], upstream[name]) for name in upstream)


@pytest.mark.parametrize("name", NAMES)
def test_sampling_and_neighbours_are_exact(clouds: dict[str, NDArray[np.generic]], name: str) -> None:
    centred, points = clouds[f"{name}/centred"], clouds[f"{name}/points"]
    if len(centred) > 1024:
        picked = farthest_points(centred, 1024, start=int(clouds[f"{name}/fps_start"]))
        until = FIRST_TIE if "ties" in name else 1024
        assert picked[:until].tolist() == clouds[f"{name}/fps_idx"][:until].tolist()
    order1, order2 = clouds[f"{name}/sa1_idx"], clouds[f"{name}/sa2_idx"]
    assert farthest_points(points, len(order1)).tolist() == order1.tolist()
    points1 = points[order1]
    assert farthest_points(points1, len(order2)).tolist() == order2.tolist()
    assert np.array_equal(first_in_range(points, points1, 0.2, 64), clouds[f"{name}/sa1_nbr"])
    assert np.array_equal(first_in_range(points1, points1[order2], 0.4, 64), clouds[f"{name}/sa2_nbr"])


@pytest.mark.parametrize("name", NAMES)
def test_readable_form(clouds: dict[str, NDArray[np.generic]], model: PointRaft, name: str) -> None:
    points = torch.from_numpy(clouds[f"{name}/points"])
    height = torch.tensor([_height(clouds, name)])
    with torch.inference_mode():
        stage1, stage2, described = model.features([points])
        weight = float(model([points], height))
        assert model.height_embed is not None
        embedded = model.height_embed(height[:, None])[0].numpy()
    expected = float(clouds[f"{name}/weight_g"])
    assert weight == pytest.approx(expected, rel=1e-4)
    for found, field in ((described[0].numpy(), "global_feature"), (embedded, "height_embedding")):
        want = clouds[f"{name}/{field}"]
        assert np.abs(found - want).max() <= 1e-4 * np.abs(want).max()
    if f"{name}/sa1_out" in clouds:
        for stage, field in ((stage1, "sa1_out"), (stage2, "sa2_out")):
            want = clouds[f"{name}/{field}"]
            assert np.abs(stage.numpy() - want).max() <= 1e-4 * np.abs(want).max()


def test_a_batch_gives_what_each_cloud_gives_alone(clouds: dict[str, NDArray[np.generic]], model: PointRaft) -> None:
    points = [torch.from_numpy(clouds[f"{name}/points"]) for name in NAMES]
    heights = torch.tensor([_height(clouds, name) for name in NAMES])
    with torch.inference_mode():
        weights = model(points, heights).numpy()
    assert weights == pytest.approx([float(clouds[f"{name}/weight_g"]) for name in NAMES], rel=1e-4)


@pytest.fixture(params=[0, 1000], ids=["edges", "rows"])
def second_stage(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """By every edge, and by rows of a neighbour, though these weights need more of them than a line takes."""
    monkeypatch.setattr(affine, "MOST_ROWS", request.param)


@pytest.mark.usefixtures("second_stage")
@pytest.mark.parametrize("name", NAMES)
def test_fast_form_equals_the_reference(clouds: dict[str, NDArray[np.generic]], model: PointRaft, name: str) -> None:
    groups = group_given(clouds[f"{name}/points"])
    assert isinstance(groups, GatheredGroups) == (name in WIDE)
    weight = FastPointRaft(state_of(model)).weigh(groups, _height(clouds, name))
    assert weight == pytest.approx(float(clouds[f"{name}/weight_g"]), rel=1e-4)


@pytest.mark.usefixtures("second_stage")
@pytest.mark.parametrize("name", NAMES)
def test_prefix_form_equals_the_readable_form_on_sampled_clouds(
    clouds: dict[str, NDArray[np.generic]], model: PointRaft, name: str
) -> None:
    """128 sampled points stand for 1024: the prediction depends on no other."""
    centred = clouds[f"{name}/centred"]
    sampled = centred[farthest_points(centred, min(1024, len(centred)))]
    with torch.inference_mode():
        expected = float(model([torch.from_numpy(sampled)], torch.tensor([_height(clouds, name)])))
    groups = group_prefix(centred)
    assert isinstance(groups, GatheredGroups) == (name in WIDE)
    assert FastPointRaft(state_of(model)).weigh(groups, _height(clouds, name)) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("centroids", [16, 64])
@pytest.mark.parametrize("name", NAMES)
def test_centroids_that_are_not_read_need_no_sampling(
    clouds: dict[str, NDArray[np.generic]], model: PointRaft, name: str, centroids: int
) -> None:
    network, centred = FastPointRaft(state_of(model), Form(centroids=centroids)), clouds[f"{name}/centred"]
    short, full = group_prefix(centred, centroids=centroids), group_prefix(centred)
    assert type(short) is type(full)
    assert network.weigh(short, _height(clouds, name)) == network.weigh(full, _height(clouds, name))


def test_a_training_step_in_float64(shared: Path, clouds: dict[str, NDArray[np.generic]]) -> None:
    with np.load(shared / "fixtures" / "train_step.npz") as file:
        expected = {name: file[name] for name in file.files}
    model = load_checkpoint(shared / "fixtures" / "pointraft_fixture.safetensors")[0].double().train()
    model.regression_head.dropout = 0.0
    names = [name for name in NAMES if name[:3] in ("c05", "c06", "c07", "c08", "c09")]
    points = [torch.from_numpy(clouds[f"{name}/points"]).double() for name in names]
    heights = torch.from_numpy(np.array([clouds[f"{name}/height"] for name in names])).double()
    predicted = model(points, heights)
    loss = torch.nn.functional.smooth_l1_loss(predicted, torch.from_numpy(expected["target"]).double(), beta=20.0)
    loss.backward()  # type: ignore[no-untyped-call]
    assert predicted.detach().numpy() == pytest.approx(expected["pred"], rel=1e-9)
    assert float(loss.detach()) == pytest.approx(float(expected["loss"]), rel=1e-9)
    buffers = dict(model.named_buffers())
    for name, want in expected.items():
        if name.startswith("after/"):
            assert buffers[name.removeprefix("after/")].numpy() == pytest.approx(want, rel=1e-9), name
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None
        gradient = parameter.grad.numpy().ravel()
        norm = float(expected[f"gradnorm/{name}"])
        if norm < 1e-6:
            continue
        want = expected[f"grad/{name}"].ravel()
        assert np.linalg.norm(gradient[: len(want)] - want) <= 1e-6 * norm, name
        assert float(np.linalg.norm(gradient)) == pytest.approx(norm, rel=1e-6), name


@pytest.mark.parametrize(("live", "kept"), [((), 4), ((5,), 4), ((0, 3, 9), 4), (tuple(range(5)), 8), (range(10), 10)])
def test_units_that_are_zero_in_all_rows_are_left_out_of_a_product(live: tuple[int, ...], kept: int) -> None:
    rng = np.random.default_rng(7)
    values, weights = np.zeros((6, 10), np.float32), rng.normal(size=(10, 3)).astype(np.float32)
    values[:, list(live)] = np.maximum(rng.normal(size=(6, len(live))), 0) + np.eye(6, len(live))
    columns, rows = live_units(values.view(np.int32), weights.view(np.int32), 4)
    assert columns.shape == (6, kept)
    assert rows.shape == (kept, 3)
    np.testing.assert_allclose(columns.view(np.float32) @ rows.view(np.float32), values @ weights, rtol=1e-6)
