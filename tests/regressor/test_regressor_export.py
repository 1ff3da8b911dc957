"""Export: ONNX says of itself what it is, and gives the weights and intervals of `weigh`, also outside our packages."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as runtime
import pytest

import tuberline
from conveyor.errors import InputError
from regressor.network.checkpoint import load_checkpoint, state_of
from regressor.network.export import described, export_onnx
from regressor.network.sidecar import Range, Sidecar, StartPolicy
from regressor.weigh.blend import SEEN, BlendRule
from regressor.weigh.quadratic import QuadraticRule
from regressor.weigh.surface import NAMES
from regressor.weigh.view_features import VIEW_NAMES
from regressor.weigh.weigher import Weigher
from tuberline.api.weighing import Weights
from tuberline.cli.checkpoints import export_onnx as export_command

pytest.importorskip("onnx")
OUTSIDE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "onnx_outside.py"
BELT_M = 0.345


def cloud(a: float, b: float, c: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(N, 3) what a camera sees of an ellipsoid with these half axes, metres, that lies on the belt."""
    x, y = np.meshgrid(np.arange(-0.06, 0.06, 0.0007), np.arange(-0.06, 0.06, 0.0007))
    inside = (x / a) ** 2 + (y / b) ** 2
    top = inside < 0.92
    return np.stack([x[top], y[top], BELT_M - c - c * np.sqrt(1 - inside[top])], axis=1)


CLOUDS = [cloud(0.028, 0.025, 0.02), cloud(0.045, 0.034, 0.029), cloud(0.058, 0.045, 0.04)]


def session(path: Path) -> Any:
    """The exported file on one thread."""
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    return runtime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def corrected(sidecar: Sidecar) -> Sidecar:
    """The same with a blend that is corrected by all that a view shows (numbers made up), as newer weights have it."""
    n = len(VIEW_NAMES)
    rng = np.random.default_rng(5)
    rule = QuadraticRule(
        intercept=0.1,
        coefficients=tuple(rng.normal(0, 0.05, n).tolist()),
        products=tuple(rng.normal(0, 0.02, n * (n + 1) // 2).tolist()),
        low=(-1.0,) * n,
        high=(6.0,) * n,
        least=-0.5,
        most=0.5,
        names=VIEW_NAMES,
    )
    blend = BlendRule(0.25, 0.01, 5.0, -0.03, (0.3,), (rule,) * len(SEEN))
    assert sidecar.volume_rule is not None
    few = len(sidecar.volume_rule["names"])
    squares = {
        "low": (0.0,) * few,
        "high": (6.0,) * few,
        "products": tuple(rng.normal(0, 0.01, few * (few + 1) // 2).tolist()),
    }
    rules = {"blend": blend.to_json(), "volume_rule": {**sidecar.volume_rule, **squares}}
    return sidecar.model_copy(update={**rules, "belt_distance_m": Range(low=0.1, high=0.8 * BELT_M)})


@pytest.mark.parametrize(
    ("kind", "batch"), [("shipped", None), ("shipped", 3), ("corrected", None), ("imported", None)]
)
def test_onnx_gives_the_weights_and_intervals_of_weigh(kind: str, batch: int | None, tmp_path: Path) -> None:
    model, shipped = load_checkpoint()
    sidecar = {"shipped": shipped, "corrected": corrected(shipped), "imported": Sidecar(name="theirs")}[kind]
    weights = Weights(sidecar, Weigher(state_of(model), sidecar))
    export_onnx(tmp_path / "net.onnx", model, sidecar, batch=batch)
    onnx = session(tmp_path / "net.onnx")
    names = [output.name for output in onnx.get_outputs()]
    assert names == ["weight_g", "low_g", "high_g", "network_g", "volume_g"]
    feeds = [
        tuberline.prepare(c, BELT_M, resting_offset_mm=3.0, weights=weights).feed(belt_sd_mm=1.5, resting_sd_mm=1.0)
        for c in CLOUDS
    ]
    stacked = {name: np.concatenate([feed[name] for feed in feeds]) for name in feeds[0]}
    found = dict(zip(names, onnx.run(names, stacked), strict=True))
    for at, points in enumerate(CLOUDS):
        expected = tuberline.weigh(
            points, belt_distance_m=BELT_M, belt_sd_mm=1.5, resting_offset_mm=3.0, resting_sd_mm=1.0, weights=weights
        )
        told = {name: float(found[name][at]) for name in names}
        assert told == pytest.approx({name: getattr(expected, name) for name in names}, abs=0.01)
    if batch is None:
        (alone,) = onnx.run(["weight_g"], feeds[1])
        assert alone == pytest.approx(found["weight_g"][1:2], abs=0.01)


def test_the_file_says_what_it_is(tmp_path: Path) -> None:
    model, sidecar = load_checkpoint()
    export_onnx(tmp_path / "net.onnx", model, sidecar)
    onnx = session(tmp_path / "net.onnx")
    assert {one.name: (one.shape, one.type) for one in onnx.get_inputs()} == {
        "groups": (["batch", 256, 3], "tensor(float)"),
        "height_m": (["batch"], "tensor(float)"),
        "features": (["batch", 35], "tensor(double)"),
        "belt_sd_m": (["batch"], "tensor(double)"),
        "noise_px": (["batch"], "tensor(double)"),
        "belt_distance_m": (["batch"], "tensor(double)"),
    }
    about = onnx.get_modelmeta().custom_metadata_map
    assert (about["name"], about["weights_sha256"]) == (sidecar.name, sidecar.sha256)
    assert (about["model"], about["licence"]) == (sidecar.model_id, "Apache-2.0")
    assert json.loads(about["ranges"])["belt_distance_m"] == sidecar.belt_distance_m.model_dump()
    assert json.loads(about["features"]) == list(NAMES)
    assert "tuberline.prepare(cloud, belt_distance_m).feed()" in about["preparation"]
    # Of an imported checkpoint it named the sampling of the shipped weights, which gives other groups.
    imported = described(sidecar.model_copy(update={"start": StartPolicy(kind="random")}))["preparation"]
    assert "belt_distance_m, weights=tuberline.load_weights(FILE)).feed()" in imported
    assert "begins at a random point" in imported
    assert onnx.get_modelmeta().producer_name == "tuberline"


def test_an_export_leaves_the_sidecar_of_other_weights(tmp_path: Path) -> None:
    """It wrote its own over it: the weights of a training beside it belonged to no sidecar any more."""
    (tmp_path / "weights.safetensors").write_bytes(b"of a training")
    with pytest.raises(InputError, match=r"weights.json would take the place of that of .*weights.safetensors; choose"):
        export_command(out=tmp_path / "weights.onnx")
    assert not (tmp_path / "weights.json").exists()


def test_a_cloud_that_is_too_wide_is_not_for_it() -> None:
    inputs = tuberline.prepare(CLOUDS[2] * [3.0, 3.0, 1.0], BELT_M)
    assert inputs.groups is None
    with pytest.raises(InputError, match=r"0\.2 m wide"):
        inputs.feed()


def test_the_script_on_the_page_needs_nothing_of_ours() -> None:
    imported = {
        alias.name
        for node in ast.walk(ast.parse(OUTSIDE.read_text()))
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    assert imported == {"json", "sys", "numpy", "onnxruntime"}


def test_the_real_tuber_weighs_the_same_outside(shared: Path, tmp_path: Path) -> None:
    ply = shared / "data" / "potatotwin_sample" / "R9-9_pcd_365.ply"
    if not ply.is_file():
        pytest.skip(f"the real cloud is not at {ply}")
    export_onnx(tmp_path / "net.onnx", *load_checkpoint())
    np.savez(tmp_path / "tuber.npz", **tuberline.prepare(ply, BELT_M).feed())
    done = subprocess.run(
        [sys.executable, str(OUTSIDE), "net.onnx", "tuber.npz"],
        cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    weight = tuberline.weigh(ply, belt_distance_m=BELT_M)
    told = f"{weight.weight_g:.1f} g, 90 % interval {weight.low_g:.1f} to {weight.high_g:.1f} g"
    assert told == "101.8 g, 90 % interval 88.2 to 118.0 g"
    assert done.stdout.splitlines()[0] == told
    assert done.stdout.splitlines()[1] == f"by {weight.model} (Apache-2.0), trained on tubers of 16 to 622 g"
