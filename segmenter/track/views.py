"""Which views of a tuber are worth weighing: a few, whole, near the centre row, spread out along the belt.

Errors are shared by a tuber's views, so three to seven well-placed ones carry nearly all of the accuracy. Each track
keeps, for each wanted position, the few frames in which it was nearest to it; the choice is made when the track is
closed and its usual area is known, so that a frame in which it was merged with a neighbour does not represent it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from conveyor.kernels import kernel
from conveyor.messages import Frame
from segmenter.frame.belt import BeltGeometry
from segmenter.frame.instances import Instances
from segmenter.frame.place import outline_size_m
from segmenter.track.constants import KEPT_PER_SLOT, LEAST_HEIGHT_M, NEAR_M, ODD_COST_M, ODD_FREE, PASSED_M, SETTLED_M


@dataclass(frozen=True, slots=True)
class Candidate:
    """A tuber cut out of one frame.

    Attributes:
        seq, captured_ns: of the frame. offset_m: belt x past the centre row.
        u0, v0, depth: first pixel of the crop and the (h, w) uint16 depth, zero outside the mask.
        belt_from_camera: (4, 4) as of that frame.
        inside: (rows, columns) bool, its cells on the analysis raster of `stride` pixels.
        area_m2, height_m, contact, whole: as in `Hit`.
    """

    seq: int
    captured_ns: int
    offset_m: float
    u0: int
    v0: int
    depth: NDArray[np.uint16]
    belt_from_camera: NDArray[np.float64]
    inside: NDArray[np.bool_]
    stride: int
    area_m2: float
    height_m: float
    contact: float
    whole: bool


class ViewShelf:
    """The best candidates so far for each wanted offset from the centre row."""

    def __init__(self, offsets_m: tuple[float, ...]) -> None:
        self._offsets_m = offsets_m
        self._slots: list[list[Candidate]] = [[] for _ in offsets_m]

    def wants(self, offset_m: float, *, whole: bool) -> bool:
        """A view at this offset would be kept by some slot."""
        return any(self._beats(slot, index, offset_m, whole) for index, slot in enumerate(self._slots))

    def offer(self, candidate: Candidate) -> None:
        """Keep a candidate where it is among the nearest."""
        for index, slot in enumerate(self._slots):
            if self._beats(slot, index, candidate.offset_m, candidate.whole):
                slot.append(candidate)
                slot.sort(key=lambda c: (not c.whole, abs(c.offset_m - self._offsets_m[index]), c.seq))
                del slot[KEPT_PER_SLOT:]

    def choose(self, usual_area_m2: float) -> list[Candidate]:
        """At most one view per slot, best slot first, no frame twice."""
        return [candidate for _, candidate in self._choice(usual_area_m2)]

    def settled(self, usual_area_m2: float, *, past_m: float) -> list[tuple[int, Candidate]]:
        """(slot, view) of the choice so far that a later frame does not better: the tuber's centre lies `past_m` past
        the row, farther from the wanted position than that view.
        """
        return [
            (index, candidate)
            for index, candidate in self._choice(usual_area_m2)
            if candidate.whole
            and past_m - self._offsets_m[index] >= max(abs(candidate.offset_m - self._offsets_m[index]), PASSED_M)
        ]

    def _choice(self, usual_area_m2: float) -> list[tuple[int, Candidate]]:
        chosen: list[tuple[int, Candidate]] = []
        for index, slot in enumerate(self._slots):
            fresh = [c for c in slot if all(c.seq != other.seq for _, other in chosen)]
            if fresh:
                chosen.append((index, min(fresh, key=lambda c: self._cost(c, index, usual_area_m2))))
        return chosen

    def clear(self) -> None:
        """Let go of all crops."""
        self._slots = [[] for _ in self._offsets_m]

    def _beats(self, slot: list[Candidate], index: int, offset_m: float, whole: bool) -> bool:
        away_m = abs(offset_m - self._offsets_m[index])
        if len(slot) < KEPT_PER_SLOT and (away_m <= NEAR_M or not slot):
            return True
        last = slot[-1]
        if whole != last.whole:
            return whole
        better_m = abs(last.offset_m - self._offsets_m[index]) - away_m
        return better_m > (0.0 if away_m <= NEAR_M else NEAR_M)

    def _cost(self, candidate: Candidate, index: int, usual_area_m2: float) -> tuple[float, int]:
        """Metres away from the slot, with what makes a view worse expressed in metres."""
        odd = abs(float(np.log(candidate.area_m2 / usual_area_m2)))
        away_m = abs(candidate.offset_m - self._offsets_m[index])
        return (0.0 if candidate.whole else 1.0) + away_m + ODD_COST_M * max(0.0, odd - ODD_FREE), candidate.seq


def slot_offsets(views: int, *, half_view_m: float, decide_m: float) -> tuple[float, ...]:
    """Wanted offsets from the centre row, best first: the row itself, then alternately before and behind it; behind
    it so far that they are seen before the track is decided, `decide_m` past the row.
    """
    reach_m = min(0.06, 0.35 * half_view_m)
    behind_m = min(reach_m, decide_m - SETTLED_M)
    steps = max(1, views // 2)
    offsets = [0.0]
    for step in range(1, steps + 1):
        offsets += [-reach_m * step / steps, behind_m * step / steps]
    return tuple(offsets[:views])


def cut_out(frame: Frame, instances: Instances, index: int, belt: BeltGeometry, *, offset_m: float) -> Candidate | None:
    """Instance `index` of a frame as a candidate; None where no pixel of it has depth."""
    stride = instances.stride
    i0, i1, j0, j1 = (int(value) for value in instances.box[index])
    inside = instances.labels[i0 : i1 + 1, j0 : j1 + 1] == index + 1
    v0, u0 = i0 * stride, j0 * stride
    crop = np.ascontiguousarray(frame.depth[v0 : v0 + inside.shape[0] * stride, u0 : u0 + inside.shape[1] * stride])
    depth, measured = _load(
        crop, inside, stride, frame.depth_scale_m, u0, v0, *belt.height_coefficients(), LEAST_HEIGHT_M
    )
    if not measured:
        return None
    return Candidate(
        seq=frame.seq,
        captured_ns=frame.captured_ns,
        offset_m=offset_m,
        u0=u0,
        v0=v0,
        depth=depth,
        belt_from_camera=belt.belt_from_camera,
        inside=inside,
        stride=stride,
        area_m2=float(instances.area_m2[index]),
        height_m=float(instances.height_m[index]),
        contact=float(instances.contact[index]),
        whole=not bool(instances.cut[index].any()),
    )


@kernel()
def _load(
    crop: NDArray[np.uint16],
    inside: NDArray[np.bool_],
    stride: int,
    scale_m: float,
    u0: int,
    v0: int,
    a: float,
    b: float,
    c: float,
    t: float,
    least_m: float,
) -> tuple[NDArray[np.uint16], bool]:
    """The crop's pixels inside the mask that stand over the belt, 0 elsewhere; whether there are any."""
    rows, columns = crop.shape
    depth = np.empty_like(crop)
    wanted = np.empty(columns, np.bool_)
    measured = np.uint16(0)
    for v in range(rows):
        if v % stride == 0:
            cells = inside[v // stride]
            for u in range(columns):
                wanted[u] = cells[u // stride] if stride > 1 else cells[u]  # whole numbers divide slowly
        own, load = crop[v], depth[v]
        for u in range(columns):  # without a branch, so that the compiler takes several pixels at once
            height_m = own[u] * scale_m * (a * (u0 + u) + b * (v0 + v) + c) + t
            load[u] = own[u] if wanted[u] & (height_m > least_m) else np.uint16(0)
            measured |= load[u]
    return depth, bool(measured)


def size_m(candidate: Candidate, belt: BeltGeometry) -> tuple[float, float]:
    """(length, width) of the smallest rectangle around a candidate's outline, metres."""
    stride = candidate.stride
    outline = _outline_px(candidate.inside, candidate.v0 // stride, candidate.u0 // stride, stride)
    length_m, width_m = outline_size_m(belt, outline, candidate.height_m)
    cell_m = belt.footprint_mm() * stride / 1000.0
    return length_m + cell_m, width_m + cell_m


def _outline_px(inside: NDArray[np.bool_], i0: int, j0: int, stride: int) -> NDArray[np.float32]:
    """(N, 2) float32 full-resolution pixels (u, v) of the outer cells of a mask."""
    contours, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cells = np.concatenate([contour[:, 0] for contour in contours]).astype(np.float32)
    return ((cells + np.array([j0, i0], np.float32)) * stride + (stride - 1) / 2).astype(np.float32)
