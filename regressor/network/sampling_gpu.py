"""Farthest-point sampling of many clouds on a GPU: one kernel, in which each cloud has a multiprocessor of its own.

Operation by operation it is 14 launches a pick; here a cloud stays on its multiprocessor from the first pick to the
last. Triton comes with every build of torch for CUDA, and needs a C compiler: see `kernel_fault` in
`regressor.network.batched`.
"""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

IN_REGISTERS = 4096
"""Points of a cloud up to which all of it stays in registers; a larger one goes through them in parts, at each pick."""
PART = 8192
POINTS_OF_A_WARP = 512

# Triton reads annotations as code, and knows none but its own.


@triton.jit
def _small(points, begins, lengths, order, span, COUNT: tl.constexpr, BLOCK: tl.constexpr):  # type: ignore[no-untyped-def]
    cloud = tl.program_id(0).to(tl.int64)
    at = tl.arange(0, BLOCK)
    here = at < tl.load(lengths + cloud)
    first = points + tl.load(begins + cloud) * 3
    x = tl.load(first + 3 * at, mask=here, other=0.0)
    y = tl.load(first + 3 * at + 1, mask=here, other=0.0)
    z = tl.load(first + 3 * at + 2, mask=here, other=0.0)
    least, most = float("-inf"), float("inf")
    tl.store(span + cloud * 3, tl.max(tl.where(here, x, least)) - tl.min(tl.where(here, x, most)))
    tl.store(span + cloud * 3 + 1, tl.max(tl.where(here, y, least)) - tl.min(tl.where(here, y, most)))
    tl.store(span + cloud * 3 + 2, tl.max(tl.where(here, z, least)) - tl.min(tl.where(here, z, most)))
    nearest = tl.where(here, most, -1.0)
    last = tl.full((), 0, tl.int32)
    tl.store(order + cloud * COUNT, last.to(tl.int64))
    for pick in range(1, COUNT):
        dx = x - tl.load(first + 3 * last)
        dy = y - tl.load(first + 3 * last + 1)
        dz = z - tl.load(first + 3 * last + 2)
        nearest = tl.minimum(nearest, dx * dx + dy * dy + dz * dz)
        last = tl.argmax(nearest, axis=0, tie_break_left=True).to(tl.int32)
        tl.store(order + cloud * COUNT + pick, last.to(tl.int64))


@triton.jit
def _large(points, begins, lengths, nearest, order, span, COUNT: tl.constexpr, BLOCK: tl.constexpr):  # type: ignore[no-untyped-def]
    cloud = tl.program_id(0).to(tl.int64)
    length = tl.load(lengths + cloud).to(tl.int32)
    begin = tl.load(begins + cloud)
    first, near = points + begin * 3, nearest + begin
    lanes = tl.arange(0, BLOCK)
    least, most = float("-inf"), float("inf")
    up, down = tl.full((), most, tl.float32), tl.full((), least, tl.float32)
    low_x, low_y, low_z = up, up, up
    high_x, high_y, high_z = down, down, down
    for start in range(0, length, BLOCK):
        at = start + lanes
        here = at < length
        x = tl.load(first + 3 * at, mask=here, other=0.0)
        y = tl.load(first + 3 * at + 1, mask=here, other=0.0)
        z = tl.load(first + 3 * at + 2, mask=here, other=0.0)
        low_x = tl.minimum(low_x, tl.min(tl.where(here, x, most)))
        low_y = tl.minimum(low_y, tl.min(tl.where(here, y, most)))
        low_z = tl.minimum(low_z, tl.min(tl.where(here, z, most)))
        high_x = tl.maximum(high_x, tl.max(tl.where(here, x, least)))
        high_y = tl.maximum(high_y, tl.max(tl.where(here, y, least)))
        high_z = tl.maximum(high_z, tl.max(tl.where(here, z, least)))
        tl.store(near + at, tl.full((BLOCK,), float("inf"), tl.float32), mask=here)
    tl.store(span + cloud * 3, high_x - low_x)
    tl.store(span + cloud * 3 + 1, high_y - low_y)
    tl.store(span + cloud * 3 + 2, high_z - low_z)
    last = tl.full((), 0, tl.int32)
    tl.store(order + cloud * COUNT, last.to(tl.int64))
    for pick in range(1, COUNT):
        from_x = tl.load(first + 3 * last)
        from_y = tl.load(first + 3 * last + 1)
        from_z = tl.load(first + 3 * last + 2)
        farthest = tl.full((), -1.0, tl.float32)
        for start in range(0, length, BLOCK):
            at = start + lanes
            here = at < length
            dx = tl.load(first + 3 * at, mask=here, other=0.0) - from_x
            dy = tl.load(first + 3 * at + 1, mask=here, other=0.0) - from_y
            dz = tl.load(first + 3 * at + 2, mask=here, other=0.0) - from_z
            distance = tl.minimum(tl.load(near + at, mask=here, other=-1.0), dx * dx + dy * dy + dz * dz)
            tl.store(near + at, distance, mask=here)
            there, place = tl.max(distance, axis=0, return_indices=True, return_indices_tie_break_left=True)
            # The first of equal ones: a later part has to be farther.
            last = tl.where(there > farthest, start + place, last).to(tl.int32)
            farthest = tl.maximum(farthest, there)
        tl.store(order + cloud * COUNT + pick, last.to(tl.int64))


def sample_by_kernel(
    points: Tensor, begins: Tensor, lengths: Tensor, *, count: int, width: int
) -> tuple[Tensor, Tensor]:
    """As `regressor.network.batched.sample_by_operations`, for tensors on a GPU. No two clouds may share points."""
    order = torch.empty((len(begins), count), dtype=torch.int64, device=points.device)
    span = torch.empty((len(begins), 3), device=points.device)
    # Each product and each sum is rounded by itself, as in the kernel for one cloud.
    if width <= IN_REGISTERS:
        _small[(len(begins),)](
            points, begins, lengths, order, span,
            COUNT=count, BLOCK=IN_REGISTERS, num_warps=IN_REGISTERS // POINTS_OF_A_WARP, enable_fp_fusion=False,
        )  # fmt: skip
    else:
        nearest = torch.empty(len(points), device=points.device)
        _large[(len(begins),)](
            points, begins, lengths, nearest, order, span,
            COUNT=count, BLOCK=PART, num_warps=PART // POINTS_OF_A_WARP, enable_fp_fusion=False,
        )  # fmt: skip
    return order, span
