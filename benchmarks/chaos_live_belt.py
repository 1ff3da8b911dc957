"""The belts of the disturbed live runs, with the truth of what had passed by when."""

from __future__ import annotations

import json
import shutil
from bisect import bisect_left
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.belt_tables import travel_told, without_travel
from camera_sim.sim.optics import Optics
from camera_sim.sim.placement import Packing
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings, layout_named
from conveyor.geometry import Intrinsics

SMALL = Optics("d405-424", Intrinsics(424, 240, 216.559, 216.014, 212.904, 121.772))
FPS, SPEED_MPS = 10.0, 0.15
TUBERS = {"encoder": 300, "two cameras": 480}
SCENES = {"encoder": "singulated", "no encoder": "singulated", "two cameras": "two-cameras"}
LANES = {"encoder": (-0.25, 0.25), "two cameras": (-0.45, 0.45)}
EVEN = Packing(tries=4, touching=0.0, gap_m=0.005, aside_m=0.012)
"""Tubers lie evenly: then the share of belt and the share of tubers differ by what is told, and not by chance."""


@dataclass(frozen=True, slots=True)
class Passed:
    """The truth of a belt: of each tuber, when it crossed (seconds after the first frame) and its weight, grams."""

    crossed_s: tuple[float, ...]
    weight_g: tuple[float, ...]
    lasts_s: float

    def between(self, from_s: float, to_s: float) -> tuple[int, float]:
        """How many crossed from one moment to another, and their weight."""
        inside = [w for t, w in zip(self.crossed_s, self.weight_g, strict=True) if from_s <= t < to_s]
        return len(inside), sum(inside)


def make_belt(kind: str, folder: Path, *, seed: int) -> Path:
    """The recording of a belt of `kind`; made where it is not there yet."""
    out = folder / f"{kind.replace(' ', '-')}-{seed}"
    if (out / "truth.json").is_file():
        return out
    if kind == "no encoder":
        return without_travel(make_belt("encoder", folder, seed=seed), out)
    layout = replace(layout_named(SCENES[kind]), packing=EVEN, lanes_m=(LANES[kind],))
    settings = SceneSettings(
        scene=SCENES[kind],
        seed=seed,
        tubers=TUBERS[kind],
        preset=PRESETS["easy"],
        optics=SMALL,
        fps=FPS,
        speed_mps=SPEED_MPS,
    )
    partial = out.with_name(out.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    record_scene(partial, settings, layout=layout)
    _end_with_the_load(partial)
    partial.rename(out)
    return out


def _end_with_the_load(recording: Path) -> None:
    """Cut off the empty belt at the recording's end: an evenly loaded belt is stopped while it is loaded."""
    last_m = max(-tuber["place_x_m"] for tuber in json.loads((recording / "truth.json").read_text())["tubers"])
    for table in recording.glob("*/frames.csv"):
        head, *rows = table.read_text().splitlines()
        kept = [row for row in rows if float(row.rpartition(",")[2]) <= last_m]
        table.write_text("\n".join([head, *kept]) + "\n")


def what_passed(recording: Path, *, travel_of: Path) -> Passed:
    """The truth of `recording`; the belt's travel is read from `travel_of`, the same belt with an encoder."""
    rows = travel_told(sorted(travel_of.glob("*/frames.csv"))[0])
    travel = [m for _, m in rows]
    tubers = json.loads((recording / "truth.json").read_text())["tubers"]
    crossed_s = []
    for tuber in tubers:
        at = min(bisect_left(travel, -tuber["place_x_m"]), len(rows) - 1)
        crossed_s.append((rows[at][0] - rows[0][0]) / 1e9)
    return Passed(tuple(crossed_s), tuple(t["weight_g"] for t in tubers), (rows[-1][0] - rows[0][0]) / 1e9)
