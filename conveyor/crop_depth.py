"""A crop's depth before anything is measured of it: flying pixels go, rows that its camera left out and holes come.

A camera that tells depth in every second row, one with bad rows, or a picture that was thinned without being made
smaller leaves whole rows or columns of a view empty. They are open to the outline, so they are no holes: every row
beside one is taken for the outline's own, high as it stands, and the volume rule takes such a view for a heavy tuber's
that lost its rim (+16 to +27 %); one empty row through the middle cuts a view in two.

Cameras lose blobs of a tuber's skin, too, and false matches put islands of it elsewhere. The volume under a hole
belongs to the tuber: its depth is interpolated from what surrounds it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel

if TYPE_CHECKING:
    from cv2.typing import MatLike

WIDEST_PIXEL_M = 0.00132
"""On the belt: of 848 pixels across 88 degrees, 0.57 m above it."""
BESIDE_M = 0.005
"""A part of a tuber that a hole cuts off lies within its depth range, give or take this; a false match does not."""
STEP_M = 0.006
MOST_MISSING = 8
"""Rows, or columns, beside each other that are filled; as many in the middle of a tuber cost 0.2 %."""
LEAST_OVERLAP, LEAST_OVERLAP_PX = 0.25, 6
"""Of a view's longest row, and pixels, that stand on both sides of an empty one: then rows are missing. Beside those
that noise empties at an outline 4 px at most stand on both sides, 0.1 of the longest row (960 views of all worlds)."""

PART = 0.1
"""Of the largest part of a view, from which on another is no speck beside it."""
LEAST_REST_PX = 2
"""Pixels beyond a gap that is too wide to be filled, from which on they are what is left of the tuber there; a single
one may be a stray of a mask. No view of 360 of `easy`, `field` and `harsh` has a pixel there."""


def pixel_width_m(belt_from_camera: NDArray[np.float64], fx: float) -> float:
    """How wide a pixel is on the belt under a camera, metres. `belt_from_camera`: (4, 4). `fx`: in pixels."""
    return float(belt_from_camera[2, 3]) / fx


def step_units(depth_scale_m: float, pixel_m: float = WIDEST_PIXEL_M) -> int:
    """Units of depth by which neighbours on one surface differ at most.

    From a pixel to the next a flank falls by more where pixels are wide (`pixel_m`, on the belt) or depth is told in
    coarse steps: within so much is near there.
    """
    return max(2, round(STEP_M * max(1.0, pixel_m / WIDEST_PIXEL_M) / depth_scale_m))


def filled_rows(depth: NDArray[np.uint16], step: int) -> tuple[NDArray[np.uint16], NDArray[np.bool_] | None]:
    """(h, w) `depth` with the rows and columns that are missing in it, from both sides, and which pixels that filled;
    the same array and None where none are missing.

    Args:
        depth: units, 0 = none. step: as `step_units` has it.
    """
    filled = depth
    for turned in (False, True):
        here = filled.T if turned else filled
        if _rows_missing(here):
            here = _between_rows(np.ascontiguousarray(here), step)
            filled = np.ascontiguousarray(here.T if turned else here)
    return filled, None if filled is depth else (filled > 0) & (depth == 0)


def _rows_missing(depth: NDArray[np.uint16]) -> bool:
    seen = depth > 0
    counts = seen.sum(1)
    full = np.flatnonzero(counts)
    gaps = np.flatnonzero(np.diff(full) > 1)
    if not len(gaps):
        return False
    least = max(LEAST_OVERLAP_PX, LEAST_OVERLAP * int(counts.max()))
    near = gaps[np.diff(full)[gaps] <= MOST_MISSING + 1]
    return any(np.count_nonzero(seen[full[i]] & seen[full[i + 1]]) >= least for i in near)


def closed(seen: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(h, w) 1 inside the outline of what is 1 in `seen`, its holes included; 0 elsewhere."""
    outlines, _ = cv2.findContours(seen, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(np.zeros_like(seen), outlines, -1, 1, cv2.FILLED), np.uint8)


def in_parts(inside: NDArray[np.bool_]) -> bool:
    """Whether an outline (h, w) falls into parts: something lies across the tuber, or there is more than one."""
    outlines, _ = cv2.findContours(inside.view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if len(outlines) < 2:
        return False
    pixels = np.array([cv2.contourArea(outline) + len(outline) / 2 + 1 for outline in outlines])  # by Pick's theorem
    return bool(np.count_nonzero(pixels >= PART * pixels.max()) > 1)


def is_parted(depth: NDArray[np.uint16]) -> bool:
    """Whether a gap of more than `MOST_MISSING` pixels parts what is seen in (h, w) `depth`, however little lies beyond
    it: that little cannot say how much the gap took.
    """
    wide = MOST_MISSING // 2
    seen = np.pad((depth > 0).astype(np.uint8), wide)
    bridged = cv2.dilate(seen, np.ones((2 * wide + 1, 2 * wide + 1), np.uint8))
    outlines, _ = cv2.findContours(bridged, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return len(outlines) > 1 and sum(_pixels(seen, outline) >= LEAST_REST_PX for outline in outlines) > 1


def _pixels(seen: NDArray[np.uint8], outline: MatLike) -> int:
    """How much of what is 1 in `seen` lies inside an outline."""
    u, v, wide, high = cv2.boundingRect(outline)
    inside = np.zeros((high, wide), np.uint8)
    cv2.drawContours(inside, [outline], -1, 1, cv2.FILLED, offset=(-u, -v))
    return int(np.count_nonzero(seen[v : v + high, u : u + wide] & inside))


@kernel(nogil=True)
def _between_rows(depth: NDArray[np.uint16], step: int) -> NDArray[np.uint16]:
    """Empty rows filled by straight lines between the rows on both sides, where those lie on one surface."""
    rows, columns = depth.shape
    out = depth.copy()
    last = -1
    for v in range(rows):
        if not depth[v].any():
            continue
        wide = v - last
        if last >= 0 and 1 < wide <= MOST_MISSING + 1:
            for u in range(columns):
                above, below = np.int64(depth[last, u]), np.int64(depth[v, u])
                if above == 0 or below == 0 or 2 * abs(below - above) >= step * wide:
                    continue
                for i in range(last + 1, v):
                    out[i, u] = (above * (v - i) + below * (i - last) + wide // 2) // wide
        last = v
    return out


def clean_depth(depth: NDArray[np.uint16], depth_scale_m: float, pixel_m: float = WIDEST_PIXEL_M) -> NDArray[np.uint16]:
    """`depth` without flying pixels and islands of false matches.

    A pixel stays if at least two of its four neighbours lie within 6 mm of it in depth (`step_units`) and at most one
    neighbour inside the mask is farther. The reference clusters with DBSCAN (0.5-1.2 s per tuber on a CPU) and drops
    noise only; the test here takes 0.05 ms and also drops the ramp of mixed pixels at an occluding edge.
    """
    step = step_units(depth_scale_m, pixel_m)
    out: NDArray[np.uint16] = _clean(depth, step)
    drop_islands(out, step, round(BESIDE_M / depth_scale_m))
    return out


@kernel(nogil=True)
def _clean(depth: NDArray[np.uint16], step: int) -> NDArray[np.uint16]:
    rows, columns = depth.shape
    out = np.zeros_like(depth)
    for v in range(rows):
        for u in range(columns):
            here = np.int64(depth[v, u])
            if here == 0:
                continue
            near = 0
            far = 0
            for dv, du in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                b, a = v + dv, u + du
                if b < 0 or a < 0 or b >= rows or a >= columns or depth[b, a] == 0:
                    continue
                if abs(np.int64(depth[b, a]) - here) < step:
                    near += 1
                else:
                    far += 1
            if near >= 2 and far <= 1:
                out[v, u] = depth[v, u]
    return out


@kernel(nogil=True)
def drop_islands(depth: NDArray[np.uint16], step: int, beside: int) -> int:
    """Zero, in place, every part of `depth` (h, w) that lies off the depth range of its largest part; pixels dropped.

    Parts are connected where 4-neighbours differ by less than `step` units; a part is off when its mean depth lies more
    than `beside` units outside the largest part's range.
    """
    rows, columns = depth.shape
    label = np.zeros((rows, columns), np.int32)
    stack = np.empty(rows * columns, np.int32)
    sizes, sums, lows, highs = [0], [0.0], [np.int64(0)], [np.int64(0)]
    for first in range(rows * columns):
        if depth.flat[first] == 0 or label.flat[first] != 0:
            continue
        name = len(sizes)
        size, total, low, high = 0, 0.0, np.int64(65535), np.int64(0)
        stack[0] = first
        top = 1
        label.flat[first] = name
        while top > 0:
            top -= 1
            v, u = stack[top] // columns, stack[top] % columns
            here = np.int64(depth[v, u])
            size += 1
            total += here
            low, high = min(low, here), max(high, here)
            for dv, du in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                b, a = v + dv, u + du
                if b < 0 or a < 0 or b >= rows or a >= columns or depth[b, a] == 0 or label[b, a] != 0:
                    continue
                if abs(np.int64(depth[b, a]) - here) < step:
                    label[b, a] = name
                    stack[top] = b * columns + a
                    top += 1
        sizes.append(size)
        sums.append(total)
        lows.append(low)
        highs.append(high)
    if len(sizes) < 3:
        return 0
    main = 1
    for name in range(2, len(sizes)):
        if sizes[name] > sizes[main]:
            main = name
    dropped = 0
    for name in range(1, len(sizes)):
        mean = sums[name] / sizes[name]
        if name != main and (mean < lows[main] - beside or mean > highs[main] + beside):
            dropped += sizes[name]
            sizes[name] = -1
    if dropped:
        for i in range(rows * columns):
            if label.flat[i] != 0 and sizes[label.flat[i]] < 0:
                depth.flat[i] = 0
    return dropped


@kernel(nogil=True)
def fill_holes(depth: NDArray[np.float64]) -> int:
    """Fill, in place, every empty pixel of `depth` (h, w) that is enclosed; how many there were.

    A filled pixel has the mean of the linear interpolations along its row and its column, each weighted by how narrow
    the hole is there: exact on a plane.
    """
    rows, columns = depth.shape
    outside, stack, top = np.zeros((rows, columns), np.bool_), np.empty(rows * columns, np.int32), 0
    for v in range(rows):
        for u in range(0, columns, 1 if v in (0, rows - 1) else max(columns - 1, 1)):
            if depth[v, u] == 0:
                outside[v, u] = True
                stack[top] = v * columns + u
                top += 1
    while top > 0:
        top -= 1
        v, u = stack[top] // columns, stack[top] % columns
        for dv, du in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            b, a = v + dv, u + du
            if 0 <= b < rows and 0 <= a < columns and depth[b, a] == 0 and not outside[b, a]:
                outside[b, a] = True
                stack[top] = b * columns + a
                top += 1
    holed_rows, holed_columns, holes = np.zeros(rows, np.bool_), np.zeros(columns, np.bool_), False
    for v in range(rows):
        for u in range(columns):
            if depth[v, u] == 0 and not outside[v, u]:
                holed_rows[v] = holed_columns[u] = holes = True
    if not holes:
        return 0
    total, weight = np.zeros((rows, columns)), np.zeros((rows, columns))
    for v in range(rows):
        if not holed_rows[v]:
            continue
        last = -1
        for u in range(columns):
            if depth[v, u] > 0:
                if last >= 0 and u - last > 1 and not outside[v, last + 1]:
                    for i in range(last + 1, u):
                        w = 1.0 / (u - last)
                        total[v, i] += w * (depth[v, last] * (u - i) + depth[v, u] * (i - last)) / (u - last)
                        weight[v, i] += w
                last = u
            elif outside[v, u]:
                last = -1
    for u in range(columns):
        if not holed_columns[u]:
            continue
        last = -1
        for v in range(rows):
            if depth[v, u] > 0:
                if last >= 0 and v - last > 1 and not outside[last + 1, u]:
                    for i in range(last + 1, v):
                        w = 1.0 / (v - last)
                        total[i, u] += w * (depth[last, u] * (v - i) + depth[v, u] * (i - last)) / (v - last)
                        weight[i, u] += w
                last = v
            elif outside[v, u]:
                last = -1
    filled = 0
    for v in range(rows):
        for u in range(columns):
            if depth[v, u] == 0 and not outside[v, u] and weight[v, u] > 0:
                depth[v, u] = total[v, u] / weight[v, u]
                filled += 1
    return filled
