"""Maps of simulated fields with known patterns against the truth: cells, delay, one scale for two machines.

    python -m benchmarks yield_map [--seeds 4101 4102 ...] [--out FOLDER]

Positions have slow noise of 0.25 m, jumps and outages; tubers roll about for 2 s on their way; machines stop now and
then. The rules of aggregator/yield_map were set on seeds 1, 2 and 4101 to 4103.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aggregator.yield_map.cells import YieldMap, cells_of, factors_to_one_scale
from aggregator.yield_map.delay import delays
from aggregator.yield_map.points import Crop, Machine, Points, cleaned, yield_points
from aggregator.yield_map.smooth import smoothed
from aggregator.yield_map.track import Track, believed, plane_of
from benchmarks.options import parser_of, whole_number
from camera_sim.sim.field import FieldWorld, SimulatedField, simulate_field

SEEDS = (5201, 5202, 5203)
WORLDS: dict[str, FieldWorld] = {
    "one machine, 3.0 m": FieldWorld(shown_share=1.0),
    "one machine, 1.5 m, slow": FieldWorld(
        width_m=1.5, size_m=(75.0, 160.0), speed_m_s=0.9, delay_s=31.0, mixing_s=4.0, noise_m=0.1, shown_share=1.0
    ),
    "two machines, one 6 % high": FieldWorld(scales=(1.0, 1.06), shown_share=1.0),
    "two machines, poor receivers": FieldWorld(scales=(1.0, 0.93), noise_m=0.5, outages=8, shown_share=1.0),
}


@dataclass(frozen=True, slots=True)
class Row:
    """One field: correlation with the truth, mean absolute error in t/ha, cells within their interval, and so on."""

    field: str
    seed: int
    delay_error_s: float
    scale_error_percent: float
    mean_error_percent: float
    correlation: dict[str, float]
    error_t_ha: dict[str, float]
    held_percent: dict[str, float]


def main(arguments: Sequence[str]) -> None:
    """Print the table; write it as JSON with --out."""
    parser = parser_of("yield_map", __doc__)
    parser.add_argument("--seeds", type=whole_number(0), nargs="+", default=list(SEEDS))
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(arguments)
    rows = [judge(name, world, seed) for name, world in WORLDS.items() for seed in options.seeds]
    print(table(rows))
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        made = [{name: getattr(row, name) for name in Row.__slots__} for row in rows]
        (options.out / "yield_map.json").write_text(json.dumps(made, indent=2) + "\n")


def judge(name: str, world: FieldWorld, seed: int) -> Row:
    """Map one simulated field in all ways and compare with its truth."""
    field = simulate_field(world, seed=seed)
    raw: list[Points] = []
    clean: list[Points] = []
    errors_s = []
    plane = None
    for machine in field.machines:
        track = Track(machine.time_ns, machine.lat_deg, machine.lon_deg, machine.quality)
        plane = plane or plane_of(track)
        path = believed(track, plane)
        crop = Crop(machine.crossed_ns / 1e9, machine.kg_each, 0.08 * machine.kg_each)
        delay_s = delays(path, crop, width_m=world.width_m)[0].delay_s
        errors_s.append(delay_s - world.delay_s)
        points, _ = yield_points(path, crop, Machine(world.width_m, delay_s, world.overlap_m))
        raw.append(points)
        clean.append(cleaned(points))
    factors = factors_to_one_scale(clean, width_m=world.width_m)
    true_ratio = world.scales[0] / world.scales[-1]
    scaled = [points.scaled(factor) for points, factor in zip(clean, factors, strict=True)]
    maps = {"raw": cells_of(raw, cell_m=10), "cleaned": cells_of(scaled, cell_m=10)}
    maps["smooth"] = smoothed(maps["cleaned"])
    assert plane is not None
    corner = plane.to_metres(np.array([world.origin_lat_deg]), np.array([world.origin_lon_deg]))[0]
    found = {way: _against(cells, field, corner) for way, cells in maps.items()}
    return Row(
        field=name,
        seed=seed,
        delay_error_s=float(max(errors_s, key=abs)),
        scale_error_percent=100 * (factors[-1] / factors[0] / true_ratio - 1),
        mean_error_percent=found["cleaned"][3],
        correlation={way: values[0] for way, values in found.items()},
        error_t_ha={way: values[1] for way, values in found.items()},
        held_percent={way: values[2] for way, values in found.items()},
    )


def _against(cells: YieldMap, field: SimulatedField, corner: np.ndarray) -> tuple[float, float, float, float]:
    """Correlation, mean absolute error (t/ha, after one scale for all cells), cells held (%), error of the mean (%).

    What two machines weigh wrong in the mean is no matter of the map: cells are judged about the map's own mean.
    """
    truth = field.t_ha(cells.centres_m() - corner)
    known = np.isfinite(cells.t_ha)
    scale = truth[known].mean() / cells.t_ha[known].mean()
    error = cells.t_ha[known] * scale - truth[known]
    held = (cells.low_t_ha[known] * scale <= truth[known]) & (truth[known] <= cells.high_t_ha[known] * scale)
    mean_scale = np.mean(field.world.scales)
    return (
        float(np.corrcoef(cells.t_ha[known], truth[known])[0, 1]),
        float(np.abs(error).mean()),
        float(100 * held.mean()),
        float(100 * (1 / scale / mean_scale - 1)),
    )


def table(rows: Sequence[Row]) -> str:
    """Markdown, one row per field and seed."""
    head = (
        "| field | seed | delay off, s | scale off, % | mean off, % | correlation: raw, cleaned, smooth | "
        "error, t/ha | cells held, % |\n| --- | ---: | ---: | ---: | ---: | --- | --- | --- |"
    )
    lines = [
        f"| {r.field} | {r.seed} | {r.delay_error_s:+.1f} | {r.scale_error_percent:+.1f} | "
        f"{r.mean_error_percent:+.1f} | "
        + " | ".join(
            ", ".join(f"{value:.{digits}f}" for value in values.values())
            for values, digits in ((r.correlation, 2), (r.error_t_ha, 1), (r.held_percent, 0))
        )
        + " |"
        for r in rows
    ]
    return "\n".join([head, *lines])
