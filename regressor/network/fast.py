"""The fast exact form of PointRAFT for one cloud at a time on the CPU.

Against the readable form: batch norm is folded into the weights, first layers are computed per point instead of per
edge, only the centroids that are read are computed, and the edges of the first stage pass through in blocks of
centroids that stay in the second-level cache. The second stage takes four rows of each neighbour in place of one for
each centroid (`regressor.network.affine`). Of the last stage only those units are carried on that some row of this
cloud wakes: behind a ReLU two in three are zero in all 128 rows, which adds nothing to a product. Clouds do not meet in
a product, so a weight does not depend on the batch it came with; on a CPU nothing is lost by that, the products of one
cloud are large enough.

Products are NumPy's. Torch's take as long where it has routines for the processor, and torch takes two seconds and 200
MB to import: a scale that only weighs does without.

Two ways to save time are not exact and have to be asked for (`Form`): products of bfloat16 operands, which are torch's
(`regressor.network.rounded`), and fewer second-stage centroids. What they cost in grams stands in docs/pointraft.md
(`python -m benchmarks regressor`).
"""

from __future__ import annotations

import platform
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Literal

import numpy as np
from llvmlite import binding
from numpy.typing import NDArray

from conveyor.threads import own_threads
from regressor.network.affine import AffineStage
from regressor.network.architecture import HEAD_NAME, HEIGHT_NAME, STAGES
from regressor.network.grouping import GatheredGroups, SharedGroups
from regressor.network.products import BLOCK_CENTROIDS, Array, Folded, PlainProducts, Wide, folded
from regressor.network.stored import State, embeds_height


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


class FastPointRaft:
    """Grams from groups. Several threads may weigh with one instance."""

    def __init__(self, state: State, form: Form = EXACT) -> None:
        """`state`: parameters as `load_weights` gives them."""
        self.form = form
        self._stages = [folded(state, name) for name in STAGES]
        self._height = folded(state, HEIGHT_NAME) if embeds_height(state) else None
        self._head = folded(state, HEAD_NAME)
        self._second: AffineStage | None = None
        if form.precision == "bfloat16":
            from regressor.network.rounded import RoundedProducts

            self._wide: Wide = RoundedProducts(self._stages)
        else:
            self._wide = PlainProducts(self._stages)
            self._second = AffineStage(self._stages[1])

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
        neighbours2 = np.concatenate([features1, centroids1], axis=1)
        features2 = self._second.pooled(neighbours2, centroids2) if self._second and index2 is None else None
        if features2 is None:
            features2 = self._abstract(1, neighbours2, centroids2, index2)
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


def _plain(mlp: Folded, x: Array) -> Array:
    """(out,) of one row (in,)."""
    for weight, bias in zip(mlp.weights[:-1], mlp.biases[:-1], strict=True):
        x = np.maximum(weight @ x + bias, np.float32(0))
    last: Array = mlp.weights[-1] @ x + mlp.biases[-1]
    return last


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
