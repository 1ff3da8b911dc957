"""One tuber in two frames: what the one shows of it beyond the other's outline, or within it.

Seen from the side, a tuber's surface goes on behind where it ends for a camera above it. So the surface that one frame
shows, put where the tuber lies in the other one, says where the other's outline ought to be: at the outermost of its
points, as long as that is not at the end of what the first frame shows. There is no model of tubers in it, and none of
the camera but its intrinsics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from segmenter.outline.body import Body
from segmenter.outline.flanks import risen_m

DIRECTIONS = 48
"""Around a tuber: 4 mm of the outline of one of 60 mm."""
LEAST_POINTS = 4
INSIDE_PX = 5.0
"""How deep inside the first frame's outline its point must lie: what a camera adds to outlines is no surface, and a
matching window adds as many pixels as it is half wide. With 3, outlines that grew by 4 px seem to have grown by none.
"""
LEAST_HIGH_M = 0.012
"""Above the belt. Lower, an instance ends where belt and tuber are told apart, and not where the tuber does."""
BEYOND_PX, MOST_OFF_PX = 25.0, 15.0
"""How far beyond a surface its outline is looked for; what seems off by more than the second is another body's."""
ALONG_PX = 0.1
CLEAR_PX = 6.0
"""Others within so much beyond an outline: it may be theirs."""
ROUNDS, DONE_M, TRIED_M, KEPT_M = 12, 1e-5, 0.006, 0.004
"""Of laying one surface on the other: at most so many rounds, until it moves by less; what differs by more in depth, in
the first round and later, is not of one place."""
SOLID_PX, STEEPEST_M, EVERY_PX, LEAST_SHARED = 4.0, 0.004, 2, 40
"""What is laid on one another: so deep inside the outlines, with no steeper step between pixels, every second pixel of
every second row, and so many of them at least."""
OUTLIER_M, LARGEST_MOVE_M, FARTHEST_M = 0.001, 0.005, 0.012


@dataclass(frozen=True, slots=True)
class Comparison:
    """What two frames say of one outline.

    Attributes:
        lost_px: how far the body reaches beyond its outline in the second frame, pixels of that, in each direction in
            which it is known; below 0 the outline reaches beyond the body.
        apart_m: belt travel from the second frame to the first.
        px_per_m: pixels of the second frame per metre, at the body.
        slip_m: how much farther along the belt the surfaces lie apart than the travel says; None: they tell nothing.
        risen_m: by how much the second frame raises flanks, by pixel inside its outline; None: as `slip_m`.
    """

    lost_px: tuple[float, ...]
    apart_m: float
    px_per_m: float
    slip_m: float | None
    risen_m: NDArray[np.float64] | None = None


def compare(first: Body, second: Body, *, farther: float = 0.0) -> Comparison | None:
    """The outline of `second` by the surface of `first`; None where nothing of it can be compared.

    Args:
        farther: by how much farther than travel says the camera is known to see tubers move, as a share. Surfaces are
            laid on one another from there on: from where travel puts them, a fifth of what they slip by is missed.
    """
    turn, shift_m = _second_from_first(first, second)
    camera_heights = np.append(first.belt_from_camera[2, :3], first.belt_from_camera[2, 3])
    reach_px, angles, depth_m = _reach(first.depth_m, first.rim_px, first.camera, camera_heights, turn, shift_m,
                                       second.camera, second.rim_px)  # fmt: skip
    if depth_m <= 0:
        return None
    lost_px = _beyond(reach_px, angles, second.rim_px, second.beside)
    apart_m = first.travel_m - second.travel_m
    start_m = np.ascontiguousarray(second.belt_from_camera[0, :3]) * (-farther * apart_m)
    moved_m = _laid_on(
        first.soft_m, first.rim_px, first.camera, turn, shift_m, second.soft_m, second.rim_px, second.camera, start_m
    )
    lies = not np.isnan(moved_m[0])
    return Comparison(
        lost_px=tuple(lost_px.tolist()),
        apart_m=apart_m,
        px_per_m=float(second.camera[0]) / depth_m,
        slip_m=float(second.belt_from_camera[0, :3] @ moved_m) if lies else None,
        risen_m=risen_m(first, second, turn, shift_m + moved_m) if lies else None,
    )


def _second_from_first(first: Body, second: Body) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3, 3) and (3,): from places in the first frame's camera to the second's, the belt having moved between."""
    back = second.belt_from_camera[:3, :3].T
    carried_m = first.belt_from_camera[:3, 3] - second.belt_from_camera[:3, 3]
    carried_m = carried_m + np.array([second.travel_m - first.travel_m, 0.0, 0.0])
    return np.ascontiguousarray(back @ first.belt_from_camera[:3, :3]), back @ carried_m


@kernel(nogil=True)
def _reach(
    depth_m: NDArray[np.float32],
    rim_px: NDArray[np.float32],
    camera: NDArray[np.float64],
    heights: NDArray[np.float64],
    turn: NDArray[np.float64],
    shift_m: NDArray[np.float64],
    to: NDArray[np.float64],
    outline_px: NDArray[np.float32],
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """How far the surface of one frame reaches in the other, from the middle of the other's outline.

    Returns:
        ((`DIRECTIONS`,) pixels, NaN where that is not known; (`DIRECTIONS`,) angles of the points that reach farthest;
        mean depth in the other camera, metres).
    """
    middle_u, middle_v, pixels = _middle(outline_px)
    reach, angles = np.full(DIRECTIONS, -1.0), np.zeros(DIRECTIONS)
    counts, known = np.zeros(DIRECTIONS, np.int64), np.zeros(DIRECTIONS, np.bool_)
    total, n = 0.0, 0
    rows, columns = depth_m.shape
    for v in range(rows):
        for u in range(columns):
            z = float(depth_m[v, u])
            if z == 0:
                continue
            x, y = (u - camera[2]) * z / camera[0], (v - camera[3]) * z / camera[1]
            high_m = heights[0] * x + heights[1] * y + heights[2] * z + heights[3]
            cz = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift_m[2]
            if cz <= 0:
                continue
            cu = (turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift_m[0]) * to[0] / cz + to[2] - middle_u
            cv = (turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift_m[1]) * to[1] / cz + to[3] - middle_v
            angle = np.arctan2(cv, cu)
            k = int((angle + np.pi) / (2 * np.pi) * DIRECTIONS) % DIRECTIONS
            away = np.hypot(cu, cv)
            total += cz
            n += 1
            counts[k] += 1
            if away > reach[k]:
                reach[k], angles[k] = away, angle
                known[k] = rim_px[v, u] >= INSIDE_PX and high_m >= LEAST_HIGH_M
    for k in range(DIRECTIONS):
        if not known[k] or counts[k] < LEAST_POINTS:
            reach[k] = np.nan
    return reach, angles, total / n if n > 0 and pixels > 0 else 0.0


@kernel(nogil=True)
def _middle(outline_px: NDArray[np.float32]) -> tuple[float, float, int]:
    """Mean column and row of an outline's pixels, and how many they are."""
    sum_u, sum_v, n = 0.0, 0.0, 0
    for v in range(outline_px.shape[0]):
        for u in range(outline_px.shape[1]):
            if outline_px[v, u] > 0:
                sum_u += u
                sum_v += v
                n += 1
    return sum_u / max(n, 1), sum_v / max(n, 1), n


@kernel(nogil=True)
def _beyond(
    reach_px: NDArray[np.float64],
    angles: NDArray[np.float64],
    outline_px: NDArray[np.float32],
    beside: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """(n,) pixels by which a surface that reaches so far goes beyond the outline, in directions where nothing else is
    near.
    """
    middle_u, middle_v, _ = _middle(outline_px)
    rows, columns = outline_px.shape
    found, n = np.empty(len(reach_px)), 0
    for k in range(len(reach_px)):
        if np.isnan(reach_px[k]):
            continue
        du, dv = np.cos(angles[k]), np.sin(angles[k])
        edge, away = 0.0, 0.0
        while away < reach_px[k] + BEYOND_PX:
            v, u = int(np.rint(middle_v + dv * away)), int(np.rint(middle_u + du * away))
            if 0 <= v < rows and 0 <= u < columns and outline_px[v, u] > 0:
                edge = away
            away += ALONG_PX
        clear, away = True, max(0.0, edge - 2.0)
        while away < max(edge, reach_px[k]) + CLEAR_PX:
            v, u = int(np.rint(middle_v + dv * away)), int(np.rint(middle_u + du * away))
            if 0 <= v < rows and 0 <= u < columns and beside[v, u]:
                clear = False
            away += 0.5
        if clear and abs(reach_px[k] - edge) <= MOST_OFF_PX:
            found[n] = reach_px[k] - edge
            n += 1
    return found[:n]


@kernel(nogil=True, error_model="numpy")
def _laid_on(
    soft_m: NDArray[np.float32],
    rim_px: NDArray[np.float32],
    camera: NDArray[np.float64],
    turn: NDArray[np.float64],
    shift_m: NDArray[np.float64],
    to_m: NDArray[np.float32],
    to_rim_px: NDArray[np.float32],
    to: NDArray[np.float64],
    start_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(3,) metres in the second camera by which the first surface must move to lie on the second; NaN: not known.

    Least squares over what both show, outliers weighed down, by Gauss and Newton, from `start_m` on.
    """
    moved = start_m.copy()
    rows, columns = soft_m.shape
    for round_no in range(ROUNDS):
        normal, right, shared = np.zeros((3, 3)), np.zeros(3), 0
        limit_m = TRIED_M if round_no == 0 else KEPT_M
        for v in range(0, rows, EVERY_PX):
            for u in range(0, columns, EVERY_PX):
                if rim_px[v, u] < SOLID_PX:
                    continue
                z = float(soft_m[v, u])
                x, y = (u - camera[2]) * z / camera[0], (v - camera[3]) * z / camera[1]
                cx = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift_m[0] + moved[0]
                cy = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift_m[1] + moved[1]
                cz = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift_m[2] + moved[2]
                pu, pv = cx * to[0] / cz + to[2], cy * to[1] / cz + to[3]
                j, i = int(np.floor(pu)), int(np.floor(pv))
                if i < 0 or j < 0 or i >= to_m.shape[0] - 1 or j >= to_m.shape[1] - 1:
                    continue
                if min(to_rim_px[i, j], to_rim_px[i + 1, j], to_rim_px[i, j + 1], to_rim_px[i + 1, j + 1]) < SOLID_PX:
                    continue
                b, a = pu - j, pv - i
                there = (1 - a) * ((1 - b) * to_m[i, j] + b * to_m[i, j + 1])
                there += a * ((1 - b) * to_m[i + 1, j] + b * to_m[i + 1, j + 1])
                along = (1 - a) * (to_m[i, j + 1] - to_m[i, j]) + a * (to_m[i + 1, j + 1] - to_m[i + 1, j])
                down = (1 - b) * (to_m[i + 1, j] - to_m[i, j]) + b * (to_m[i + 1, j + 1] - to_m[i, j + 1])
                off = there - cz
                if abs(off) >= limit_m or abs(along) >= STEEPEST_M or abs(down) >= STEEPEST_M:
                    continue
                g0, g1 = along * to[0] / cz, down * to[1] / cz
                weight = 1 / (1 + (off / OUTLIER_M) ** 2)
                slopes = (g0, g1, -1.0)
                for m in range(3):
                    right[m] -= weight * slopes[m] * off
                    for k in range(3):
                        normal[m, k] += weight * slopes[m] * slopes[k]
                shared += 1
        step = _solved(normal, right)
        if shared < LEAST_SHARED or np.isnan(step[0]):
            return np.full(3, np.nan)
        for m in range(3):
            moved[m] += min(max(step[m], -LARGEST_MOVE_M), LARGEST_MOVE_M)
        if np.abs(step).max() < DONE_M:
            break
    if np.abs(moved).max() > FARTHEST_M:
        return np.full(3, np.nan)
    return moved


@kernel(nogil=True, error_model="numpy")
def _solved(normal: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) x of the symmetric (3, 3) `normal` x = `right`, by its adjugate; NaN where there is none."""
    a, b, c = normal[0, 0], normal[0, 1], normal[0, 2]
    d, e, f = normal[1, 1], normal[1, 2], normal[2, 2]
    inverse = np.array([[d * f - e * e, c * e - b * f, b * e - c * d],
                        [c * e - b * f, a * f - c * c, b * c - a * e],
                        [b * e - c * d, b * c - a * e, a * d - b * b]])  # fmt: skip
    size = a * inverse[0, 0] + b * inverse[0, 1] + c * inverse[0, 2]
    out = np.full(3, np.nan)
    if abs(size) > 1e-12 * max(a * d * f, 1e-30):
        for m in range(3):
            out[m] = (inverse[m, 0] * right[0] + inverse[m, 1] * right[1] + inverse[m, 2] * right[2]) / size
    return out
