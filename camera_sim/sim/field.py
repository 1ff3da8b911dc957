"""A simulated field: a known pattern of yield, machines that lift it pass by pass, their positions and what they see.

Nothing of a camera is simulated here: tubers pass it `delay_s` after they were lifted, mixed by webs and elevators, as
times and true weights. Positions are those of a receiver with noise, outages and jumps.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from conveyor.geometry import EARTH_M_PER_DEG


@dataclass(frozen=True, slots=True)
class FieldWorld:
    """What is drawn; lengths in metres, times in seconds.

    Attributes:
        size_m: (east, north) of the field; rows run north.
        mean_t_ha: of the whole field; `contrast`: standard deviation of the pattern over the mean.
        patch_m: how large good and bad places are.
        width_m: working width; `overlap_m`: by how much a pass overlaps the one before.
        speed_m_s: of the machine in the row; every `stop_every_s` it stands for `stop_s`.
        box_kg: where not 0, it stands for `stop_s` whenever it has lifted that much: the box is changed.
        delay_s: from ground to camera; `mixing_s`: mean of the exponential time that a tuber rolls about.
        noise_m: slow error of positions (correlated over a minute); `jump_m`, `outages`: now and then.
        tuber_g: mean weight of a tuber; its standard deviation is 45 % of it.
        scales: by what each machine's weights are wrong, one entry for each machine; passes go round among them.
        shown_share: what share of the tubers is drawn as tubers, each of them standing for more (keeps runs small).
        origin_lat_deg, origin_lon_deg: of the south-west corner; start_ns: Unix time of the first second.
    """

    size_m: tuple[float, float] = (120.0, 200.0)
    mean_t_ha: float = 45.0
    contrast: float = 0.25
    patch_m: float = 35.0
    width_m: float = 3.0
    overlap_m: float = 0.1
    speed_m_s: float = 1.4
    stop_every_s: float = 240.0
    stop_s: float = 25.0
    box_kg: float = 0.0
    delay_s: float = 17.0
    mixing_s: float = 2.0
    noise_m: float = 0.25
    jump_m: float = 60.0
    outages: int = 3
    tuber_g: float = 120.0
    scales: tuple[float, ...] = (1.0,)
    shown_share: float = 0.05
    origin_lat_deg: float = 52.7
    origin_lon_deg: float = 5.75
    start_ns: int = 1_790_000_000_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class MachineDay:
    """One machine's day. Positions: `time_ns`, `lat_deg`, `lon_deg`, `quality`, (N,) each, with errors. Tubers:
    `crossed_ns`, `weight_g`, (M,) each: a tuber's weight stands for `1 / shown_share` tubers; `lifted_m` (M, 2) is
    where it grew, metres east and north of the corner, `box` (M,) the box that was filled then, from 0."""

    time_ns: NDArray[np.int64]
    lat_deg: NDArray[np.float64]
    lon_deg: NDArray[np.float64]
    quality: NDArray[np.uint8]
    crossed_ns: NDArray[np.int64]
    weight_g: NDArray[np.float64]
    kg_each: NDArray[np.float64]
    lifted_m: NDArray[np.float64]
    box: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedField:
    """The field and what its machines did; `t_ha(xy_m)` is the truth."""

    world: FieldWorld
    machines: tuple[MachineDay, ...]
    _waves: NDArray[np.float64] = field(repr=False)

    def t_ha(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """True yield at (..., 2) metres east and north of the south-west corner, tonnes per hectare."""
        return _pattern(self.world, self._waves, xy_m)


def simulate_field(world: FieldWorld, *, seed: int) -> SimulatedField:
    """Draw the pattern and let the machines lift it."""
    rng = np.random.default_rng(seed)
    waves = np.stack(
        [*(rng.normal(0, 1 / world.patch_m, (2, 40))), rng.uniform(0, 2 * np.pi, 40), rng.normal(0, 1, 40)]
    )
    machines = tuple(
        _machine(world, waves, number=number, rng=np.random.default_rng((seed, number)))
        for number in range(len(world.scales))
    )
    return SimulatedField(world, machines, waves)


def _pattern(world: FieldWorld, waves: NDArray[np.float64], xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
    phases = xy_m[..., 0, None] * waves[0] + xy_m[..., 1, None] * waves[1] + waves[2]
    unit = (np.cos(phases) * waves[3]).sum(-1) * np.sqrt(2 / (waves[3] ** 2).sum())
    pattern: NDArray[np.float64] = world.mean_t_ha * np.maximum(1 + world.contrast * unit, 0.1)
    return pattern


def _machine(world: FieldWorld, waves: NDArray[np.float64], *, number: int, rng: np.random.Generator) -> MachineDay:
    xy_m, lifting = _drive(world, number=number)
    kg = _lifted_kg(world, waves, xy_m, lifting)
    if world.box_kg:
        xy_m, kg = _with_box_changes(world, xy_m, kg)
    count = len(xy_m)
    box = np.floor(np.cumsum(kg) / world.box_kg).astype(np.int64) if world.box_kg else np.zeros(count, np.int64)
    shown = rng.poisson(kg * 1000 / world.tuber_g * world.shown_share)
    weights = np.maximum(rng.normal(world.tuber_g, 0.45 * world.tuber_g, shown.sum()), 10.0)
    second = np.repeat(np.arange(count), shown)
    lifted_s = second - rng.uniform(0, 1, shown.sum())
    crossed_s = lifted_s + world.delay_s - world.mixing_s + rng.exponential(world.mixing_s, shown.sum())
    order = np.argsort(crossed_s, kind="stable")
    weights = weights[order] * world.scales[number]
    seen_m, quality = _received(world, xy_m, rng)
    lat, lon = _degrees(world, seen_m)
    return MachineDay(
        time_ns=world.start_ns + (np.arange(count) * 1e9).astype(np.int64),
        lat_deg=lat,
        lon_deg=lon,
        quality=quality,
        crossed_ns=world.start_ns + (crossed_s[order] * 1e9).astype(np.int64),
        weight_g=weights,
        kg_each=weights / 1000 / world.shown_share,
        lifted_m=xy_m[second][order],
        box=box[second][order],
    )


def _lifted_kg(
    world: FieldWorld, waves: NDArray[np.float64], xy_m: NDArray[np.float64], lifting: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """(N,) kilograms lifted in each second: the strip is the width less what the pass before has lifted."""
    way = np.diff(xy_m, axis=0, prepend=xy_m[:1])
    length = np.hypot(way[:, 0], way[:, 1])
    return np.where(lifting, length * (world.width_m - world.overlap_m) * _pattern(world, waves, xy_m) / 10, 0.0)


def _with_box_changes(
    world: FieldWorld, xy_m: NDArray[np.float64], kg: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions and kilograms with the machine standing for `stop_s` before the second that begins another box."""
    boxes = np.floor(np.cumsum(kg) / world.box_kg)
    changes = np.flatnonzero(np.diff(boxes) > 0) + 1
    stands = np.repeat(changes, int(world.stop_s))
    return np.insert(xy_m, stands, xy_m[stands - 1], axis=0), np.insert(kg, stands, 0.0)


def _drive(world: FieldWorld, *, number: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(N, 2) true positions second by second, and whether the machine lifts; it turns outside of the field."""
    step = world.width_m - world.overlap_m
    east, north = world.size_m
    xy: list[tuple[float, float]] = []
    lifting: list[bool] = []
    passes = range(number, int(east / step), len(world.scales))
    for n, index in enumerate(passes):
        x = world.width_m / 2 + index * step
        up = n % 2 == 0
        y = 0.0
        while y < north:
            xy.append((x, y if up else north - y))
            lifting.append(True)
            if world.stop_every_s and len(xy) % int(world.stop_every_s) == 0:
                xy += [xy[-1]] * int(world.stop_s)
                lifting += [False] * int(world.stop_s)
            y += world.speed_m_s
        end_y = north if up else 0.0
        out = 1.0 if up else -1.0
        following = x + step * len(world.scales)
        for part in np.linspace(0, np.pi, 18):  # a turn on the headland takes 18 s
            xy.append((x + (following - x) * (1 - np.cos(part)) / 2, end_y + out * 6 * np.sin(part)))
            lifting.append(False)
    return np.array(xy), np.array(lifting)


def _received(
    world: FieldWorld, xy_m: NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """What a receiver says of true positions: slow noise, some jumps of a second, some outages of twenty."""
    count = len(xy_m)
    keep = np.exp(-1 / 60)
    noise = np.zeros((count, 2))
    steps = rng.normal(0, world.noise_m * np.sqrt(1 - keep**2), (count, 2))
    noise[0] = rng.normal(0, world.noise_m, 2)
    for i in range(1, count):
        noise[i] = keep * noise[i - 1] + steps[i]
    seen, quality = xy_m + noise, np.full(count, 4, dtype=np.uint8)
    for at in rng.integers(0, count, world.outages):
        seen[at] += rng.normal(0, world.jump_m, 2)
    for at in rng.integers(0, max(count - 20, 1), world.outages):
        quality[at : at + 20] = 0
    return seen, quality


def _degrees(world: FieldWorld, xy_m: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Latitude and longitude by the sphere's metres per degree, good to 0.3 % at this size."""
    lat = world.origin_lat_deg + xy_m[:, 1] / EARTH_M_PER_DEG
    return lat, world.origin_lon_deg + xy_m[:, 0] / (EARTH_M_PER_DEG * np.cos(np.radians(world.origin_lat_deg)))
