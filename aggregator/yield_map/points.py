"""Yield points: what came off the field in each second, where it grew, and why a point is not used.

Points are kept as they are; cleaning only gives them a reason. The rules are those that published cleaners of yield
maps share: no position, standing, turning, the ramps at both ends of a pass, ground that was harvested already,
and yields far outside the field's own.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from aggregator.yield_map.ground import Harvested, harvest_in_order
from aggregator.yield_map.track import Path
from conveyor.errors import InputError

STEP_S = 1.0
MOST_AHEAD_M = 20.0
"""Of the antenna, in front of the share or behind it."""
SLOWEST_M_S = 0.15
RAMP_S = 4.0
"""How long a pass's first and last stretch is filled by the mixing on webs and elevators rather than by the ground."""
LEAST_FLOW = 0.15
HALF_FLOW = 0.5
MIXED_S = 15.0
LEAST_NEW = 0.3
WHOLE_NEW = 0.7
"""From this share of new ground on a strip counts as whole: a receiver's noise of some decimetres makes gaps and
overlaps that are not there, and counting only the overlaps would make every yield too high."""
TURN_RAD = np.radians(35.0)
TURN_OVER_S = 4.0
SHORTEST_PASS_S = 8.0
FAR_OUT = 4.0
"""In robust standard deviations of the field's points, by logarithm."""


class Unused(StrEnum):
    """Why a yield point is not used for the map; '' for one that is used."""

    NO = ""
    POSITION = "no position"
    STANDING = "standing"
    TURNING = "turning"
    RAMP = "start or end of a pass"
    OVERLAP = "no new ground"
    OUTLIER = "far from the field's yields"


@dataclass(frozen=True, slots=True, eq=False)
class Crop:
    """What passed the cameras of one machine: (N,) times in seconds, kilograms and their standard deviations; what is
    one tuber for a line may be a second's flow for another monitor (`count` 1 then stands for one reading)."""

    time_s: NDArray[np.float64]
    kg: NDArray[np.float64]
    sd_kg: NDArray[np.float64]

    def __post_init__(self) -> None:
        assert len(self.time_s) == len(self.kg) == len(self.sd_kg)

    def only(self, which: NDArray[np.bool_]) -> Crop:
        """Some of it; (N,)."""
        return Crop(self.time_s[which], self.kg[which], self.sd_kg[which])


@dataclass(frozen=True, slots=True)
class Machine:
    """How a machine harvests.

    Attributes:
        width_m: working width of the share.
        delay_s: time from ground to camera.
        overlap_m: by how much a pass is meant to overlap the one before.
        antenna_ahead_m: how far the antenna is in front of the share that lifts the crop.
    """

    width_m: float
    delay_s: float
    overlap_m: float = 0.0
    antenna_ahead_m: float = 0.0

    def __post_init__(self) -> None:
        if not 0.2 <= self.width_m <= 50:
            raise InputError(f"working width is {self.width_m:g} m; allowed are 0.2 to 50 m")
        if not 0 <= self.overlap_m <= self.width_m / 2:
            raise InputError(
                f"overlap is {self.overlap_m:g} m; allowed are 0 to half the width, {self.width_m / 2:g} m"
            )
        if not -60 <= self.delay_s <= 600:
            raise InputError(f"delay from ground to camera is {self.delay_s:g} s; allowed are -60 to 600 s")
        if not abs(self.antenna_ahead_m) <= MOST_AHEAD_M:
            raise InputError(
                f"the antenna is {self.antenna_ahead_m:g} m in front of the share; allowed are -{MOST_AHEAD_M:g} to "
                f"{MOST_AHEAD_M:g} m"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """One machine's yield points, one per second of its path; all arrays have N rows.

    Attributes:
        time_s: when the ground was lifted.
        xy_m: the middle of the strip lifted, metres of the field.
        speed_m_s, pass_number: of the machine; passes count from 0, -1 where it stands or turns.
        kg, var_kg2, count: what came from there, its variance, and of how many tubers.
        area_m2: of the ground that counts for it.
        ground: the fine squares that were lifted for the first time (`ground.Harvested`).
        unused: why the point is not used, as `Unused`.
    """

    time_s: NDArray[np.float64]
    xy_m: NDArray[np.float64]
    speed_m_s: NDArray[np.float64]
    pass_number: NDArray[np.int64]
    kg: NDArray[np.float64]
    var_kg2: NDArray[np.float64]
    count: NDArray[np.int64]
    area_m2: NDArray[np.float64]
    ground: Harvested
    unused: NDArray[np.str_]

    @property
    def t_ha(self) -> NDArray[np.float64]:
        """(N,) tonnes per hectare of lifted ground; NaN where there was none."""
        area = self.area_m2
        yields: NDArray[np.float64] = np.divide(self.kg * 10, area, out=np.full(len(area), np.nan), where=area > 0)
        return yields

    @property
    def used(self) -> NDArray[np.bool_]:
        """(N,) which points the map is made of."""
        used: NDArray[np.bool_] = self.unused == Unused.NO
        return used

    def scaled(self, factor: float) -> Points:
        """The same points with `factor` times the kilograms."""
        return replace(self, kg=self.kg * factor, var_kg2=self.var_kg2 * factor**2)

    def reasons(self) -> dict[str, int]:
        """How many points are unused, by reason."""
        return dict(Counter(str(reason) for reason in self.unused if reason != Unused.NO))


def yield_points(path: Path, crop: Crop, machine: Machine) -> tuple[Points, float]:
    """All points of one machine, unjudged but for those without a place, and the kilograms that no point holds.

    Each second of the path lifts the strip between its two ends; what passed the camera `delay_s` later came from it.
    Webs mix the crop of some seconds: what comes out as if lifted while the machine stood or turned goes to the nearest
    second in which it lifted.
    """
    edges_s = np.arange(path.time_s[0], path.time_s[-1] + STEP_S, STEP_S)
    middle_s = (edges_s[:-1] + edges_s[1:]) / 2
    lifted_s = crop.time_s - machine.delay_s
    index = np.searchsorted(edges_s, lifted_s, "right") - 1
    inside = (index >= 0) & (index < len(middle_s))
    shares = _shares(path, edges_s, machine)
    known = path.known(middle_s) & np.isfinite(shares).all(axis=(1, 2))
    speed = np.interp(middle_s, path.time_s, path.speed_m_s)
    heading = path.heading_at(middle_s)
    passes = pass_numbers(middle_s, heading, speed, known)
    index[inside] = _nearest_lifting(known, passes)[index[inside]]
    sums: list[NDArray[np.float64]] = [
        np.bincount(index[inside], weights=values[inside], minlength=len(middle_s)).astype(np.float64)
        for values in (crop.kg, crop.sd_kg**2, np.ones(len(crop.kg)))
    ]
    lifting = known & (passes >= 0) & _flows(sums[0])
    ground = harvest_in_order(shares[:, 0], shares[:, 1], width_m=machine.width_m, known=lifting)
    unused = np.full(len(middle_s), Unused.NO, dtype="<U32")
    unused[~known] = Unused.POSITION
    points = Points(
        time_s=middle_s,
        xy_m=shares.mean(axis=1),
        speed_m_s=speed,
        pass_number=passes,
        kg=sums[0],
        var_kg2=sums[1],
        count=sums[2].astype(np.int64),
        area_m2=_area(ground, machine),
        ground=ground,
        unused=unused,
    )
    return points, float(crop.kg[~inside].sum())


def cleaned(points: Points) -> Points:
    """The same points, each of those not to be used with its reason; the first that applies, in `Unused`'s order."""
    unused = points.unused.copy()

    def rule(which: NDArray[np.bool_], reason: Unused) -> None:
        unused[which & (unused == Unused.NO)] = reason

    rule(points.speed_m_s <= SLOWEST_M_S, Unused.STANDING)
    rule(points.pass_number < 0, Unused.TURNING)
    rule(_ramps(points), Unused.RAMP)
    rule(points.ground.area_m2 <= LEAST_NEW * points.ground.swept_m2, Unused.OVERLAP)
    left = (unused == Unused.NO) & (points.area_m2 > 0)
    if left.sum() >= 20:
        smooth = _moving_sum(points.kg, 5) / np.maximum(_moving_sum(points.area_m2, 5), 1e-9)
        logs = np.log(np.maximum(smooth, 1e-6))
        middle = np.median(logs[left])
        spread = max(1.4826 * float(np.median(np.abs(logs[left] - middle))), 0.1)
        rule(left & (np.abs(logs - middle) > FAR_OUT * spread), Unused.OUTLIER)
    return replace(points, unused=unused)


def pass_numbers(
    time_s: NDArray[np.float64],
    heading_rad: NDArray[np.float64],
    speed_m_s: NDArray[np.float64],
    known: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """(N,) which straight pass each second belongs to, from 0; -1 while standing, turning, or in a pass too short."""
    reach = round(TURN_OVER_S / STEP_S / 2)
    count = len(time_s)
    before, after = np.maximum(np.arange(count) - reach, 0), np.minimum(np.arange(count) + reach, count - 1)
    turn = np.abs(np.angle(np.exp(1j * (heading_rad[after] - heading_rad[before]))))
    working = known & (speed_m_s > SLOWEST_M_S) & (turn < TURN_RAD)
    numbers = np.full(count, -1, dtype=np.int64)
    starts = np.flatnonzero(working & ~np.r_[False, working[:-1]])
    ends = np.flatnonzero(working & ~np.r_[working[1:], False]) + 1
    number = 0
    for start, end in zip(starts, ends, strict=True):
        if (end - start) * STEP_S >= SHORTEST_PASS_S:
            numbers[start:end] = number
            number += 1
    return numbers


def _flows(kg: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) whether anything to speak of comes: a share that is up, on the headland, lifts no ground."""
    smooth = _moving_sum(kg, 5)
    flowing = smooth[smooth > 0]
    return smooth > (LEAST_FLOW * float(np.median(flowing)) if len(flowing) else 0.0)


def _nearest_lifting(known: NDArray[np.bool_], passes: NDArray[np.int64]) -> NDArray[np.int64]:
    """(N,) of each second the nearest one on a pass, up to `MIXED_S` away; its own where there is none, or no place."""
    own = np.arange(len(known))
    lifting = np.flatnonzero(passes >= 0)
    if not len(lifting):
        return own
    after = np.clip(np.searchsorted(lifting, own), 0, len(lifting) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.where(np.abs(lifting[before] - own) <= np.abs(lifting[after] - own), lifting[before], lifting[after])
    return np.where(known & (np.abs(nearer - own) * STEP_S <= MIXED_S), nearer, own)


def _area(ground: Harvested, machine: Machine) -> NDArray[np.float64]:
    """(N,) square metres that each second's crop grew on."""
    whole = ground.area_m2 >= WHOLE_NEW * ground.swept_m2
    return np.where(whole, ground.swept_m2 * (1 - machine.overlap_m / machine.width_m), ground.area_m2)


def _shares(path: Path, edges_s: NDArray[np.float64], machine: Machine) -> NDArray[np.float64]:
    """(N, 2, 2): where the share was at the start and the end of each second."""
    ends = path.at(np.clip(edges_s, path.time_s[0], path.time_s[-1]))
    heading = path.heading_at(edges_s)
    ends = ends - machine.antenna_ahead_m * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.stack([ends[:-1], ends[1:]], axis=1)


def _ramps(points: Points) -> NDArray[np.bool_]:
    """(N,) the ends of each pass, from where the flow has come to half of the pass's own, and `RAMP_S` more."""
    ramp = np.zeros(len(points.time_s), dtype=bool)
    seconds = round(RAMP_S / STEP_S)
    flow = _moving_sum(points.kg, 3)
    for number in range(int(points.pass_number.max(initial=-1)) + 1):
        of_pass = np.flatnonzero(points.pass_number == number)
        full = np.flatnonzero(flow[of_pass] >= HALF_FLOW * np.median(flow[of_pass]))
        ramp[of_pass] = True
        if len(full):
            ramp[of_pass[full[0] + seconds : max(full[-1] + 1 - seconds, 0)]] = False
    return ramp


def _moving_sum(values: NDArray[np.float64], over: int) -> NDArray[np.float64]:
    return np.convolve(values, np.ones(over), mode="same")
