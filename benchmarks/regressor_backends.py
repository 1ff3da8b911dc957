"""Ways to compute PointRAFT on one core, each as a function from a slice of the clouds to their grams."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.command import tuberline
from conveyor.errors import TuberlineError
from conveyor.extras import install_hint
from regressor.network.architecture import NEIGHBOURS
from regressor.network.checkpoint import model_of
from regressor.network.export import OPSET, ExportedPointRaft
from regressor.network.fast import (
    FastPointRaft,
    Form,
    groups_tensor,
    multiplies_bfloat16,
)
from regressor.network.grouping import CENTROIDS_2, SharedGroups, group_prefix
from regressor.network.pointraft import PointRaft
from regressor.network.rounded import fused_layer, packed_weight
from regressor.network.sampling import farthest_points
from regressor.network.stored import load_weights
from regressor.training.labelled import read_labelled

VIEWS = 64
POINTS = 1024
CALIBRATION_VIEWS = 32
PRODUCTS = (
    (2048, 64, 64, 2),
    (2048, 64, 128, 2),
    (2048, 128, 128, 4),
    (2048, 128, 256, 4),
    (128, 259, 256, 1),
    (128, 256, 512, 1),
    (128, 512, 1024, 1),
)
"""Rows, inner and outer width, and how often: the products of one cloud in blocks of 2048 edges, 1.09 GFLOP."""

Runner = Callable[[slice], NDArray[np.float64]]
Sampler = Callable[[NDArray[np.float32], int], NDArray[np.int64]]


@dataclass(frozen=True, slots=True)
class Clouds:
    """Cleaned, centred clouds, (N, 3) float32 metres each, and their clamped heights; no radius binds in them."""

    points: tuple[NDArray[np.float32], ...]
    height_m: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def load(cls, folder: Path | None, *, weights: Path | None, scratch: Path) -> Self:
        """The first 64 fitting views of a pack, or of one simulated now."""
        folder = folder or simulated_views(scratch)
        highest_m = load_weights(weights)[1].input.max_height_m
        kept = []
        for view in read_labelled(folder):
            cloud = view.prepare()
            if len(cloud.points) > POINTS and isinstance(group_prefix(cloud.points), SharedGroups):
                kept.append((cloud.points, cloud.clamped_height_m(highest_m)))
            if len(kept) == VIEWS:
                break
        if len(kept) < VIEWS:
            raise TuberlineError(f"{folder} holds {len(kept)} clouds that fit; {VIEWS} are needed")
        return cls(tuple(points for points, _ in kept), np.array([height for _, height in kept], np.float32))


def simulated_views(scratch: Path) -> Path:
    """A pack of views made now, in `scratch`."""
    folder = scratch / "views"
    options = ("--tubers", "36", "--views", "2", "--seed", "612", "--preset", "field")
    tuberline("simulate-views", "--out", folder, *options)
    return folder


def backends(clouds: Clouds, *, weights: Path | None, scratch: Path) -> dict[str, Runner]:
    """Every back end by name, warm."""
    state, _ = load_weights(weights)
    model = model_of(state)
    graph = _network_alone(scratch / "network.onnx", model)
    forms = {"exact": Form(), "float32, 16 centroids": Form(centroids=16)}
    if multiplies_bfloat16():
        forms |= {"bfloat16": Form("bfloat16"), "bfloat16, 16 centroids": Form("bfloat16", 16)}
    else:
        sys.stderr.write("bfloat16 is left out, for this processor does not multiply it\n")
    runners = {
        "the reference's operators": _reference(model_of(state), clouds, inside=cluster_farthest_points),
        "the readable form": _reference(model, clouds),
    }
    runners |= {name: _fast(FastPointRaft(state, form), clouds) for name, form in forms.items()}
    runners["ONNX Runtime, float32"] = _onnxruntime(graph, clouds)
    runners["ONNX Runtime, int8"] = _onnxruntime(_quantised(graph, clouds), clouds)
    if find_spec("openvino"):
        runners["OpenVINO, float32"] = _openvino(graph, clouds, "f32")
        runners["OpenVINO, bfloat16"] = _openvino(graph, clouds, "bf16")
    else:
        sys.stderr.write(f"OpenVINO is left out, for it is not installed: {install_hint('backends')}\n")
    for run in runners.values():
        run(slice(0, 2))
    return runners


def _network_alone(path: Path, model: PointRaft) -> Path:
    """The network as ONNX without the rules that an export puts around it: all back ends compute the same."""
    names, out = ("groups", "height_m"), "network_g"
    example = torch.zeros(2, 2 * NEIGHBOURS + CENTROIDS_2, 3), torch.zeros(2)
    with warnings.catch_warnings(), torch.no_grad():  # both as in regressor/network/export.py
        warnings.simplefilter("ignore")
        torch.onnx.export(
            ExportedPointRaft(model),
            example,
            str(path),
            input_names=list(names),
            output_names=[out],
            dynamic_axes={name: {0: "batch"} for name in (*names, out)},
            opset_version=OPSET,
            dynamo=False,
        )
    return path


def _reference(model: PointRaft, clouds: Clouds, *, inside: Sampler = farthest_points) -> Runner:
    """Sampling to 1024, 512 and 128 points, ball queries, every edge: the readable form, as the reference computes.

    `inside` samples within the network, where the reference takes torch_cluster's operator. Its sampling to 1024 points
    (torch_fpsample) is as fast as ours; its ball query is slower than ours, which stands for it here.
    """
    model.sa1_module.sample = model.sa2_module.sample = inside  # type: ignore[assignment]

    def run(rows: slice) -> NDArray[np.float64]:
        sampled = [torch.from_numpy(cloud[farthest_points(cloud, POINTS)]) for cloud in clouds.points[rows]]
        with torch.inference_mode():
            return np.asarray(model(sampled, torch.from_numpy(clouds.height_m[rows])).numpy(), np.float64)

    return run


def cluster_farthest_points(points: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    """The same sampling with the tensor operations that torch_cluster's operator for CPUs makes (fps_cpu.cpp)."""
    cloud = torch.from_numpy(points)
    chosen = torch.zeros(count, dtype=torch.int64)
    nearest = (cloud - cloud[0]).pow_(2).sum(1)
    for pick in range(1, count):
        farthest = nearest.argmax()
        chosen[pick] = farthest
        nearest = torch.minimum(nearest, (cloud - cloud[farthest]).pow_(2).sum(1))
    return chosen.numpy()


def _fast(network: FastPointRaft, clouds: Clouds) -> Runner:
    def run(rows: slice) -> NDArray[np.float64]:
        pairs = zip(clouds.points[rows], clouds.height_m[rows], strict=True)
        return np.array([network.weigh(group_prefix(points), float(height)) for points, height in pairs])

    return run


def _inputs(clouds: Clouds, rows: slice) -> dict[str, NDArray[np.float32]]:
    groups = [group_prefix(points) for points in clouds.points[rows]]
    stacked = np.stack([groups_tensor(group) for group in groups if isinstance(group, SharedGroups)])
    return {"groups": stacked, "height_m": clouds.height_m[rows]}


def _onnxruntime(graph: Path, clouds: Clouds) -> Runner:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(graph), options, providers=["CPUExecutionProvider"])
    return lambda rows: np.asarray(session.run(None, _inputs(clouds, rows))[0], np.float64)


def _openvino(graph: Path, clouds: Clouds, precision: str) -> Runner:
    import openvino

    settings = {"INFERENCE_NUM_THREADS": 1, "NUM_STREAMS": 1, "INFERENCE_PRECISION_HINT": precision}
    compiled = openvino.Core().compile_model(str(graph), "CPU", settings)
    request = compiled.create_infer_request()
    return lambda rows: np.asarray(request.infer(_inputs(clouds, rows))[compiled.output(0)], np.float64)


def _quantised(graph: Path, clouds: Clouds) -> Path:
    """The wide products in int8 (static ranges from 32 clouds, weights per channel)."""
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

    class Reader(CalibrationDataReader):  # type: ignore[misc]
        def __init__(self) -> None:
            self._rest = iter([_inputs(clouds, slice(at, at + 1)) for at in range(CALIBRATION_VIEWS)])

        def get_next(self) -> dict[str, NDArray[np.float32]] | None:
            return next(self._rest, None)

    out = graph.with_name("int8.onnx")
    quantize_static(
        str(graph),
        str(out),
        Reader(),
        quant_format=QuantFormat.QDQ,
        op_types_to_quantize=["MatMul", "Gemm"],
        per_channel=True,
        activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8,
    )
    return out


def product_seconds() -> float:
    """Process time of all of one cloud's float32 products alone, by oneDNN with packed weights; the exact form leaves
    out a part of the last stage's.

    Raises:
        TuberlineError: this build of torch has no oneDNN.
    """
    layer = fused_layer()
    if layer is None:
        raise TuberlineError("this build of torch has no oneDNN, whose products are the limit that is told")
    total = 0.0
    for rows, inner, outer, times in PRODUCTS:
        x, weight = torch.ones(rows, inner), packed_weight(torch.ones(outer, inner), rows)
        layer(x, weight, None, False)
        started = time.process_time()
        for _ in range(times):
            layer(x, weight, None, False)
        total += time.process_time() - started
    return total
