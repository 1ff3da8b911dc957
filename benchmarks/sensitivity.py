"""What a millimetre of resting level is worth on a tuber's weight, by its outline, for weights as shipped.

The same simulated views are weighed with the resting level lowered by 1 to 6 mm. To first order the volume under the
surface grows by outline area times the shift, so grams per mm = k * density * pi/4 * length * width, by caliper; k is
fitted here.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from aggregator.calibration.sensitivity import outline_g_per_mm
from benchmarks.options import parser_of, whole_number
from camera_sim.sim.view_setting import ViewPlan
from camera_sim.sim.views import ViewSimulator
from conveyor.geometry import straight_down_belt_from_camera

SHIFTS_MM = (0.0, 1.0, 3.0, 6.0)
STRIDE = 5


def main(arguments: Sequence[str]) -> None:
    """Simulate, weigh and print a Markdown table."""
    parser = parser_of("sensitivity", __doc__)
    parser.add_argument("--tubers", type=whole_number(1), default=60, help="of each preset")
    parser.add_argument("--seed", type=whole_number(0), default=41711)
    parser.add_argument("--presets", nargs="+", default=["easy", "field"])
    parser.add_argument("--weights", type=Path, help="default: the shipped ones")
    given = parser.parse_args(arguments)
    print(f"Seed {given.seed}; k of grams per mm over {outline_g_per_mm.__name__}, from shifts of 1 to 6 mm.\n")
    print("| preset | method | tubers | k of the total | scatter of k, % | % per mm | below 80 g | 300 g up |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for preset in given.presets:
        grams, unit_g_per_mm = shifted(preset, tubers=given.tubers, seed=given.seed, weights=given.weights)
        for column, method in enumerate(("as weighed", "volume rule")):
            print(f"| {preset} | {method} | {row(grams[:, :, column], unit_g_per_mm)} |")


def row(grams: NDArray[np.float64], unit_g_per_mm: NDArray[np.float64]) -> str:
    """Cells of one method: (n, shifts) grams, (n,) grams per mm for k = 1."""
    shifts = np.array(SHIFTS_MM[1:])
    per_mm = ((grams[:, 1:] - grams[:, :1]) @ shifts) / (shifts @ shifts)
    k, share = per_mm / unit_g_per_mm, 100 * per_mm / grams[:, 0]
    small, large = share[grams[:, 0] < 80], share[grams[:, 0] >= 300]
    means = " | ".join(f"{part.mean():.2f}" if len(part) else "-" for part in (share, small, large))
    scatter = 100 * 1.4826 * np.median(np.abs(k / np.median(k) - 1))
    return f"{len(grams)} | {per_mm.sum() / unit_g_per_mm.sum():.3f} | {scatter:.1f} | {means}"


def shifted(
    preset: str, *, tubers: int, seed: int, weights: Path | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """((n, shifts, 2) grams as weighed and by the volume rule, (n,) grams per mm for k = 1); refused views left out."""
    from regressor.weigh.prepare import RefusedCloud, prepare_depth
    from regressor.weigh.weigher import Weigher

    weigher = Weigher.load(weights)
    simulator = ViewSimulator(ViewPlan(seed, 1, preset, distance_range_m=(0.30, 0.55)))
    grams, units = [], []
    for number in range(tubers):
        for view in simulator.views(number * STRIDE):
            k, weighed = view.intrinsics, []
            try:
                for shift_mm in SHIFTS_MM:
                    cloud = prepare_depth(
                        view.depth,
                        depth_scale_m=view.depth_scale_m,
                        fx=k.fx,
                        fy=k.fy,
                        cx=k.cx - view.u0,
                        cy=k.cy - view.v0,
                        belt_from_camera=straight_down_belt_from_camera(
                            view.belt_distance_m + view.resting_m + shift_mm / 1000
                        ),
                    )
                    answer = weigher.weigh(cloud)
                    weighed.append((answer.weight_g, answer.volume_g))
            except RefusedCloud:
                continue
            grams.append(weighed)
            units.append(outline_g_per_mm(*view.tuber.axes_mm[:2], k=1.0))
    return np.array(grams), np.array(units)
