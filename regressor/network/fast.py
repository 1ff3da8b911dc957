"""The fast exact form of PointRAFT for one cloud at a time on the CPU.

Against the readable form: batch norm is folded into the weights, first layers are computed per point instead of per
edge, only the centroids that are read are computed, and the edges pass through in blocks of centroids that stay in the
second-level cache. Of the last stage only those units are carried on that some row of this cloud wakes: behind a ReLU
two in three are zero in all 128 rows, which adds nothing to a product. Clouds do not meet in a product, so a weight
does not depend on the batch it came with; on a CPU nothing is lost by that, the products of one cloud are large enough.

Products are NumPy's. Torch's take as long where it has routines for the processor, and torch takes two seconds and 130
MB to import: a scale that only weighs does without.

Two ways to save time are not exact and have to be asked for (`Form`): products of bfloat16 operands, which are torch's
(`regressor.network.rounded`), and fewer second-stage centroids. What they cost in grams stands in docs/pointraft.md
(`python -m benchmarks regressor`).
"""

from __future__ import annotations

import platform
import threading
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any, Literal, Protocol

import numpy as np
from llvmlite import binding
from numpy.typing import NDArray

from conveyor.threads import own_threads
from regressor.network.architecture import HEAD_NAME, HEIGHT_NAME, NEIGHBOURS, NORM_EPSILON, STAGES
from regressor.network.edges import add_bias, edge_differences, live_units, pooled_maximum
from regressor.network.grouping import GatheredGroups, SharedGroups
from regressor.network.stored import State, embeds_height

BLOCK_CENTROIDS = 32
LIVE_STEP = 32
"""See `live_units`."""
Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Form:
    """How a network is computed. The default is exact.

    Attributes:
        precision: of the operands of the wide products; sums are float32 in both.
        centroids: of the second stage that are used, at most, where all of them have the same neighbours; None is all.
    """

    precision: Literal["float32", "bfloat16"] = "float32"
    centroids: int | None = None

    @property
    def flags(self) -> tuple[str, ...]:
        """What a weight from this form is flagged with."""
        rounded = ("bfloat16",) if self.precision == "bfloat16" else ()
        return rounded if self.centroids is None else (*rounded, f"centroids_{self.centroids}")


EXACT = Form()


@dataclass(frozen=True, slots=True)
class Folded:
    """Weights (out, in) and biases (out,) of a shared MLP with its batch norms folded in."""

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]


class Wide(Protocol):
    """The wide products of a network, in one precision. Several threads may use one instance."""

    def abstract(self, stage: int, sources: list[Array], centroids: Array, out: Array) -> None:
        """The maximum over the neighbours of each centroid, without the last bias.

        Args:
            stage: the first set abstraction, 0, or the second, 1.
            sources: (K, W) first layer of the neighbours, one for all centroids or one for each.
            centroids: (C, W) what the first layer makes of each centroid. out: (C, O) float32, is written.
        """

    def describe(self, rows: Array) -> Array:
        """(1024,) the last stage of (C, 259) rows, without its last bias."""


class FastPointRaft:
    """Grams from groups. Several threads may weigh with one instance."""

    def __init__(self, state: State, form: Form = EXACT) -> None:
        """`state`: parameters as `load_weights` gives them."""
        self.form = form
        self._stages = [folded(state, name) for name in STAGES]
        self._height = folded(state, HEIGHT_NAME) if embeds_height(state) else None
        self._head = folded(state, HEAD_NAME)
        if form.precision == "bfloat16":
            from regressor.network.rounded import RoundedProducts

            self._wide: Wide = RoundedProducts(self._stages)
        else:
            self._wide = PlainProducts(self._stages)

    def weigh(self, groups: SharedGroups | GatheredGroups, height_m: float) -> float:
        """Grams of one cloud. `height_m`: above the belt, clamped, metres."""
        with own_threads():
            x = self._describe(groups)
            if self._height is not None:
                x = np.concatenate([x, _plain(self._height, np.array([height_m], np.float32))])
            return float(_plain(self._head, x)[0])

    def _describe(self, groups: SharedGroups | GatheredGroups) -> Array:
        """(1024,) global feature."""
        if isinstance(groups, SharedGroups):
            used = slice(self.form.centroids)
            source, index1, index2 = groups.neighbours, None, None
        else:
            used = slice(None)  # each centroid has a part of the cloud of its own to tell of
            source, index1, index2 = groups.points, groups.neighbours1, groups.neighbours2
        centroids1, centroids2 = groups.centroids1, groups.centroids2[used]
        features1 = self._abstract(0, source, centroids1, index1)
        features2 = self._abstract(1, np.concatenate([features1, centroids1], axis=1), centroids2, index2)
        described = self._wide.describe(np.concatenate([features2, centroids2], axis=1))
        return described + self._stages[2].biases[2]

    def _abstract(self, stage: int, inputs: Array, centroids: Array, index: NDArray[np.int64] | None) -> Array:
        """(C, O): max over the neighbours (`inputs` (K, G + 3), or those that (C, 64) `index` picks)."""
        mlp = self._stages[stage]
        source = inputs @ mlp.weights[0].T + mlp.biases[0]
        centroid = centroids @ mlp.weights[0][:, -3:].T
        pooled = np.empty((len(centroid), len(mlp.biases[2])), np.float32)
        for begin in range(0, len(centroid), BLOCK_CENTROIDS):
            part = slice(begin, begin + BLOCK_CENTROIDS)
            sources = [source] if index is None else [source[neighbours] for neighbours in index[part]]
            self._wide.abstract(stage, sources, centroid[part], pooled[part])
        return pooled + mlp.biases[2]


class PlainProducts:
    """Float32 by NumPy."""

    def __init__(self, stages: list[Folded]) -> None:
        self._stages = stages
        # (I, O) each: of these the rows of live units are picked.
        self._last_two = [np.ascontiguousarray(weight.T) for weight in stages[2].weights[1:]]
        self._rooms = _Rooms()

    def abstract(self, stage: int, sources: list[Array], centroids: Array, out: Array) -> None:
        """As `Wide` says."""
        mlp, room = self._stages[stage], self._rooms.of
        rows = len(centroids) * NEIGHBOURS
        edges, hidden, values = (
            room(stage, name, rows, weight.shape[0]) for name, weight in zip("ehv", mlp.weights, strict=True)
        )
        differences(sources, centroids, edges, edge_differences)
        np.matmul(edges, mlp.weights[1].T, out=hidden)
        add_bias(hidden, mlp.biases[1])
        np.matmul(hidden, mlp.weights[2].T, out=values)
        pooled_maximum(values, out)

    def describe(self, rows: Array) -> Array:
        """As `Wide` says."""
        mlp = self._stages[2]
        x = rows @ mlp.weights[0].T
        add_bias(x, mlp.biases[0])
        x = self._live(x, 0)
        add_bias(x, mlp.biases[1])
        described: Array = self._live(x, 1).max(axis=0)
        return described

    def _live(self, x: Array, layer: int) -> Array:
        """(R, O) product of activations (R, I) and one of the last two layers' weights, by the live units."""
        columns, rows = live_units(x.view(np.int32), self._last_two[layer].view(np.int32), LIVE_STEP)
        product: Array = columns.view(np.float32) @ rows.view(np.float32)
        return product


def differences(sources: list[Array], centroids: Array, edges: NDArray[Any], kernel: Any) -> None:
    """ReLU of each neighbour's first layer less its centroid's, into (C * K, W) `edges`, by a kernel of `edges`."""
    if len(sources) == 1:
        kernel(sources[0], centroids, edges)
        return
    for row, source in enumerate(sources):
        kernel(source, centroids[row : row + 1], edges[row * NEIGHBOURS : (row + 1) * NEIGHBOURS])


class _Rooms(threading.local):
    """Room for the edges of one block, kept from cloud to cloud. Each thread has its own: it writes while it weighs."""

    def __init__(self) -> None:
        self._made: dict[tuple[int, str], Array] = {}

    def of(self, stage: int, name: str, rows: int, width: int) -> Array:
        """(rows, width); what stood there before is not kept."""
        if (stage, name) not in self._made:
            self._made[stage, name] = np.empty((BLOCK_CENTROIDS * NEIGHBOURS, width), np.float32)
        return self._made[stage, name][:rows]


def _plain(mlp: Folded, x: Array) -> Array:
    """(out,) of one row (in,)."""
    for weight, bias in zip(mlp.weights[:-1], mlp.biases[:-1], strict=True):
        x = np.maximum(weight @ x + bias, np.float32(0))
    last: Array = mlp.weights[-1] @ x + mlp.biases[-1]
    return last


def folded(state: State, name: str) -> Folded:
    """The shared MLP `name` of a network, each batch norm folded into the linear layer before it, in float64."""
    weights, biases, index = [], [], 0
    while f"{name}.lins.{index}.weight" in state:
        weight, bias = (state[f"{name}.lins.{index}.{part}"].astype(np.float64) for part in ("weight", "bias"))
        norm = f"{name}.norms.{index}.module"
        if f"{norm}.weight" in state:
            scale, shift, mean, variance = (
                state[f"{norm}.{part}"].astype(np.float64) for part in ("weight", "bias", "running_mean", "running_var")
            )
            scale = scale / np.sqrt(variance + NORM_EPSILON)
            weight, bias = weight * scale[:, None], (bias - mean) * scale + shift
        weights.append(weight.astype(np.float32))
        biases.append(bias.astype(np.float32))
        index += 1
    return Folded(tuple(weights), tuple(biases))


@cache
def multiplies_bfloat16() -> bool:
    """Whether oneDNN, torch's library of products, multiplies bfloat16 on this processor.

    An x86 one needs AVX-512 or AVX-NE-CONVERT for it; on one without, torch is not even imported to ask. Elsewhere
    oneDNN is asked for a product: it may be told to use less than the processor has (`ONEDNN_MAX_CPU_ISA`). A host
    without torch multiplies none.
    """
    if find_spec("torch") is None:
        return False
    if platform.machine() in ("x86_64", "AMD64"):
        features = binding.get_host_cpu_features()
        if not features.get("avx512bw") and not features.get("avxneconvert"):
            return False
    from regressor.network.rounded import onednn_multiplies_bfloat16

    return onednn_multiplies_bfloat16()


def groups_tensor(groups: SharedGroups) -> Array:
    """(256, 3) float32: the three lists end to end, the fixed shape an exported network takes."""
    return np.concatenate([groups.neighbours, groups.centroids1, groups.centroids2])
