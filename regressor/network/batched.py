"""Many clouds in one pass, for a GPU: sampling and the shared-neighbour form on fixed shapes, on any torch device.

On a CPU `regressor.network.fast` is quicker, as nothing is gained by batches there; the same code runs on it, and is
tested there. On a GPU each shape of a pass is captured once as a CUDA graph and replayed: a pass is some hundred
kernels, and to launch them one by one would take longer than they run. Clouds whose radius binds are weighed by the
form for one cloud. Products of many clouds at once may differ in the last bits from those of one; the points that are
picked never do.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from regressor.network.architecture import NEIGHBOURS, RADIUS_1_M
from regressor.network.checkpoint import model_of
from regressor.network.device import usable_device
from regressor.network.export import ExportedPointRaft
from regressor.network.fast import FastPointRaft, groups_tensor
from regressor.network.grouping import (
    BOX_MARGIN,
    CENTROIDS_2,
    CLOUD_POINTS,
    GatheredGroups,
    SharedGroups,
    group_prefix,
    stage_counts,
)
from regressor.network.stored import State

MOST = 128
"""Clouds of one pass."""
MOST_POINTS = 1 << 21
"""Points of all clouds of one pass."""
WIDTHS = (4096, 16384, 65536)
"""How many points the largest cloud of a pass may have. With 1, 2, 4 .. 128 clouds these are few shapes, so that a
graph is captured seldom. What is larger is weighed alone."""
KERNEL_NEEDS = "give the machine Triton, a C compiler and Python's headers (Debian: gcc, python3-dev)"


class BatchedPointRaft:
    """Grams of many clouds at once. Not thread-safe: one instance per worker."""

    def __init__(
        self,
        state: State,
        *,
        device: str = "cuda",
        points: int = CLOUD_POINTS,
        graphs: bool = True,
        kernel: bool = True,
    ) -> None:
        """`state`: parameters as `load_weights` gives them; `device` as torch names it.

        Args:
            points: how many the network is given of a larger cloud.
            graphs, kernel: on a GPU, replay captured passes, and sample by one kernel; False launches operation by
                operation, to compare.

        Raises:
            InputError: this machine or this build of torch does not have it.
        """
        self._device = usable_device(device)
        self._points = points
        self._alone = FastPointRaft(state)
        self._network = ExportedPointRaft(model_of(state)).to(self._device)
        self._count = max(NEIGHBOURS, stage_counts(points)[1])
        self._sample = _sampler(self._device, count=self._count) if kernel else sample_by_operations
        self._put = _Put(self._device, places=len(places_of(1, points)))
        self._passes: dict[tuple[int, int], _Pass] = {}
        # All graphs work in the same memory: only one runs at a time.
        self._pool = torch.cuda.graph_pool_handle() if graphs and self._device.type == "cuda" else None

    def weigh(self, groups: Sequence[SharedGroups | GatheredGroups], heights_m: Sequence[float]) -> NDArray[np.float64]:
        """(n,) grams of n clouds; heights above the belt, clamped, metres."""
        weight_g = np.empty(len(groups))
        together = [i for i, group in enumerate(groups) if isinstance(group, SharedGroups)]
        for i, group in enumerate(groups):
            if isinstance(group, GatheredGroups):
                weight_g[i] = self._alone.weigh(group, heights_m[i])
        if together:
            stacked = _stacked([groups_tensor(group) for group in groups if isinstance(group, SharedGroups)])
            height_m = torch.tensor([heights_m[i] for i in together], dtype=torch.float32, device=self._device)
            with torch.inference_mode():
                found = self._network(torch.from_numpy(stacked).to(self._device), height_m)
            weight_g[together] = found.double().cpu().numpy()
        return weight_g

    def weigh_clouds(self, clouds: Sequence[NDArray[np.float32]], heights_m: Sequence[float]) -> NDArray[np.float64]:
        """(n,) grams of n clouds, each (N, 3), centred, metres, sampled here from its first point on (`group_prefix`).

        Heights as in `weigh`.
        """
        weight_g, is_weighed = np.empty(len(clouds)), np.zeros(len(clouds), bool)
        fitting = [i for i, cloud in enumerate(clouds) if len(cloud) <= WIDTHS[-1]]
        for chosen in _passes_of(fitting, [len(cloud) for cloud in clouds]):
            some = [clouds[i] for i in chosen]
            self._put.fill(some, [heights_m[i] for i in chosen], [self._places(len(cloud)) for cloud in some])
            weight_g[chosen], is_weighed[chosen] = self._pass(some).run(len(some))
        for i in np.flatnonzero(~is_weighed).tolist():
            weight_g[i] = self.weigh([group_prefix(clouds[i], points=self._points)], [heights_m[i]])[0]
        return weight_g

    def _places(self, length: int) -> NDArray[np.int64]:
        return places_of(min(length, self._points), self._points)

    def _pass(self, clouds: Sequence[NDArray[np.float32]]) -> _Pass:
        """One whose shape holds these clouds."""
        longest = max(len(cloud) for cloud in clouds)
        batch, width = 1 << (len(clouds) - 1).bit_length(), next(width for width in WIDTHS if width >= longest)
        if (batch, width) not in self._passes:
            steps = _Steps(self._network, self._sample, self._count, width)
            self._passes[batch, width] = _Pass(steps, self._put.given(batch), pool=self._pool)
        return self._passes[batch, width]


class Sampler(Protocol):
    """As `sample_by_operations`."""

    def __call__(
        self, points: Tensor, begins: Tensor, lengths: Tensor, *, count: int, width: int
    ) -> tuple[Tensor, Tensor]: ...


class _Put:
    """Where clouds are put, one after the other; always the same memory, for a graph reads where it once did."""

    def __init__(self, device: torch.device, *, places: int) -> None:
        def zeros(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros(shape, dtype=dtype, pin_memory=device.type == "cuda")

        whole = torch.int64
        self._host = (
            zeros(MOST_POINTS, 3),
            zeros(MOST, dtype=whole),
            zeros(MOST, dtype=whole),
            zeros(MOST, places, dtype=whole),
            zeros(MOST),
        )
        self._device = tuple(part.to(device, copy=True) for part in self._host)
        self._points, self._begins, self._lengths, self._places, self._heights = (part.numpy() for part in self._host)

    def fill(
        self,
        clouds: Sequence[NDArray[np.float32]],
        heights_m: Sequence[float],
        places: Sequence[NDArray[np.int64]],
    ) -> None:
        """Put these clouds there. A pass may hold more: those have no points, for two clouds that share some would
        write to the same memory while they are sampled.
        """
        lengths = [len(cloud) for cloud in clouds]
        n, total = len(clouds), sum(lengths)
        np.concatenate(clouds, out=self._points[:total])
        self._begins[:n] = np.cumsum([0, *lengths[:-1]])
        self._lengths[:n], self._lengths[n:] = lengths, 0
        self._places[:n] = places
        self._heights[:n] = heights_m
        for device, host, used in zip(self._device, self._host, (total, n, MOST, n, n), strict=True):
            device[:used].copy_(host[:used], non_blocking=True)

    def given(self, batch: int) -> tuple[Tensor, ...]:
        """All points, and the begins, lengths, places and heights of the first `batch` clouds."""
        points, *others = self._device
        return points, *(part[:batch] for part in others)


class _Steps:
    """From what was put to grams."""

    def __init__(self, network: ExportedPointRaft, sample: Sampler, count: int, width: int) -> None:
        self._network, self._sample, self._count, self._width = network, sample, count, width

    def __call__(self, points: Tensor, begins: Tensor, lengths: Tensor, places: Tensor, heights: Tensor) -> Tensor:
        """(2, batch) float64: grams, and 1 where a cloud's box says that no radius binds (`radius_is_free_of`)."""
        order, span = self._sample(points, begins, lengths, count=self._count, width=self._width)
        groups = points[begins[:, None] + order.gather(1, places)]
        grams = self._network(groups, heights)
        is_free = span.double().norm(dim=1) < RADIUS_1_M * BOX_MARGIN
        return torch.stack([grams.double(), is_free.double()])


class _Pass:
    """All passes of one shape; on a GPU as a graph."""

    def __init__(self, steps: _Steps, given: tuple[Tensor, ...], *, pool: Any | None) -> None:
        """`pool`: memory of graphs; None: without one."""
        self._steps, self._given = steps, given
        self._graph: torch.cuda.CUDAGraph | None = None
        if pool is not None:
            self._capture(pool)

    def run(self, n: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """(n,) grams, and (n,) whether they hold: not where a radius may bind, which this form does not look at."""
        with torch.inference_mode():
            if self._graph is not None:
                self._graph.replay()
                found = self._found
            else:
                found = self._steps(*self._given)
            weight_g, is_free = found[:, :n].cpu().numpy()
        return weight_g, is_free > 0

    def _capture(self, pool: Any) -> None:
        # As PyTorch asks for it: once outside, on a stream of its own, so that libraries and kernels are ready.
        aside = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        aside.wait_stream(torch.cuda.current_stream())
        with torch.inference_mode():
            with torch.cuda.stream(aside):
                self._steps(*self._given)
            torch.cuda.current_stream().wait_stream(aside)
            graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(graph, pool=pool):
                self._found = self._steps(*self._given)
        self._graph = graph


def _stacked(groups: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """(n, longest, 3): of 2048 points a small cloud has fewer centroids than a large one; its last one is repeated."""
    longest = max(len(group) for group in groups)
    return np.stack([np.pad(group, ((0, longest - len(group)), (0, 0)), mode="edge") for group in groups])


def _passes_of(which: Sequence[int], lengths: Sequence[int]) -> Iterator[list[int]]:
    """Which clouds go into one pass each, in their order."""
    chosen: list[int] = []
    points = 0
    for i in which:
        if len(chosen) == MOST or points + lengths[i] > MOST_POINTS:
            yield chosen
            chosen, points = [], 0
        chosen.append(i)
        points += lengths[i]
    if chosen:
        yield chosen


@lru_cache(maxsize=4096)
def places_of(used: int, points: int) -> NDArray[np.int64]:
    """(64 + 64 + 128 or more,) int64: which pick of a cloud of `used` points stands where in `groups_tensor`.

    Groups are padded by repetition. `points`: how many the network is given of a larger cloud.
    """
    count1, count2 = stage_counts(used)
    lists = (
        (min(NEIGHBOURS, used), NEIGHBOURS),
        (min(NEIGHBOURS, count1), NEIGHBOURS),
        (min(count2, used), max(CENTROIDS_2, stage_counts(points)[1])),
    )
    places: NDArray[np.int64] = np.concatenate([np.resize(np.arange(picked), length) for picked, length in lists])
    places.flags.writeable = False
    return places


def _sampler(device: torch.device, *, count: int) -> Sampler:
    """What samples on that device: the kernel where it can be built, or plain operations."""
    if device.type != "cuda":
        return sample_by_operations
    if fault := kernel_fault(device, count=count):
        logging.getLogger("regressor").warning("%s; %s", fault, KERNEL_NEEDS)
        return sample_by_operations
    from regressor.network.sampling_gpu import sample_by_kernel

    return sample_by_kernel


def kernel_fault(device: torch.device, *, count: int = CENTROIDS_2) -> str | None:
    """Why the sampling kernel cannot be built for that GPU, and what that means; None where it can."""
    try:
        from regressor.network.sampling_gpu import sample_by_kernel

        begins = torch.zeros(1, dtype=torch.int64, device=device)
        for width in WIDTHS:
            sample_by_kernel(torch.zeros(1, 3, device=device), begins, begins + 1, count=count, width=width)
    except Exception as error:  # Triton raises what the machine's compiler says, by no common class
        return f"the GPU's sampling kernel cannot be built here, so a pass takes four times as long ({error})"
    return None


def sample_by_operations(
    points: Tensor, begins: Tensor, lengths: Tensor, *, count: int, width: int
) -> tuple[Tensor, Tensor]:
    """Greedy farthest-point sampling of many clouds at once, each from its first point, ties as in `farthest_points`.

    Args:
        points: (M, 3) float32, all clouds one after the other, finite.
        begins, lengths: (B,) int64, where each begins, and its 0 to `width` points; on the same device.
        count: how many to pick of each; beyond its length a cloud's picks say nothing.

    Returns:
        (B, count) int64 indices within each cloud in the order of selection, and (B, 3) float32 the sides of its box.
    """
    at = torch.arange(width, device=points.device)[None]
    here = at < lengths[:, None]
    # Behind its end stands what the next one begins with.
    clouds = points[(begins[:, None] + at).clamp(max=len(points) - 1)]
    highest = torch.where(here[..., None], clouds, -torch.inf).amax(1)
    lowest = torch.where(here[..., None], clouds, torch.inf).amin(1)
    x, y, z = (clouds[..., axis].contiguous() for axis in range(3))
    nearest = torch.where(here, torch.inf, -1.0)
    order = torch.zeros((len(begins), count), dtype=torch.int64, device=points.device)
    last = order[:, :1]
    for pick in range(1, count):
        dx, dy, dz = (axis - axis.gather(1, last) for axis in (x, y, z))
        # Each product and each sum rounded by itself, as the kernel for one cloud does it.
        nearest = torch.minimum(nearest, dx * dx + dy * dy + dz * dz)
        last = nearest.argmax(dim=1, keepdim=True)  # the first of equal ones
        order[:, pick] = last[:, 0]
    return order, highest - lowest
