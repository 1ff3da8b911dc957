"""Simulated belts with known foreign matter: what the segmenter counts and what it refuses, against the truth."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.sizes_belts import segmented
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.scenes import SceneSettings, in_its_world, layout_named
from conveyor.messages import Track
from conveyor.messages.base import plain

WITHIN_M = 0.025


@dataclass(frozen=True, slots=True)
class ForeignPlan:
    """One belt: so many others per tuber in the mean."""

    name: str
    preset: str
    seed: int
    tubers: int
    others: float
    scene: str = "distractors"


LEARNED: tuple[tuple[str, int, tuple[str, ...], tuple[float, ...], int], ...] = (
    ("fit", 61000, ("field", "easy"), (0.1, 0.4), 60),
    ("judge", 63000, ("field", "easy"), (0.0, 0.05, 0.15, 0.3), 80),
    ("fresh", 65000, ("field",), (0.0, 0.05, 0.15, 0.3), 80),
)
"""By name: first seed, presets, others a tuber, tubers. All but the first judged a rule; the next learned by them."""

SCENES = (("distractors", 0.0), ("distractors", 0.05), ("distractors", 0.15), ("distractors", 0.3), ("crowded", 0.15))
"""Scene and others a tuber of belts that are as long as half a load. Those of seeds 69000 and on judged too: they
showed clods that were taken for tubers weighed too high."""


def _long(first: int) -> tuple[ForeignPlan, ...]:
    return tuple(
        ForeignPlan(f"load-{first}-{scene}-{others:g}-{n}", "field", first + 10 * j + n, 160, others, scene)
        for j, (scene, others) in enumerate(SCENES)
        for n in range(2)
    )


PLANS: dict[str, tuple[ForeignPlan, ...]] = {
    "fit": (
        *(
            ForeignPlan(f"{name}-{preset}-{others:g}-{n}", preset, first + 100 * i + 10 * j + n, tubers, others)
            for name, first, presets, shares, tubers in LEARNED
            for i, preset in enumerate(presets)
            for j, others in enumerate(shares)
            for n in range(2)
        ),
        *_long(67000),
    ),
    "judge": (*_long(71000), *_long(73000), *_long(75000), *_long(77000)),
}
SPEED_MPS = 0.45
"""Seeds fixed before any was run; `benchmarks clods` has others."""


def measured(plan: ForeignPlan) -> dict[str, Any]:
    """Tracks counted and refused, with what each truly is, and the truth of the belt."""
    layout = replace(layout_named(plan.scene), distractors=plan.others)
    settings = in_its_world(
        SceneSettings(
            scene=plan.scene, seed=plan.seed, tubers=plan.tubers, preset=PRESETS[plan.preset], speed_mps=SPEED_MPS
        ),
        layout,
    )
    closed, foreign, core, truth = segmented(settings, layout)
    rows = [*truth["tubers"], *truth["distractor_places"]]
    places = np.array([(row["place_x_m"], row["place_y_m"]) for row in rows]).reshape(-1, 2)
    kinds = ["tuber"] * len(truth["tubers"]) + [row["kind"] for row in truth["distractor_places"]]
    return {
        "plan": plain(plan),
        "tracks": [_labelled(track, places, kinds, rows) for track in [*(c.track for c in closed), *foreign]],
        "discarded": {str(reason): n for reason, n in core.discarded.items()},
        "tubers": truth["tubers"],
        "foreign": truth["distractor_places"],
    }


def _labelled(track: Track, places: Any, kinds: list[str], rows: list[dict[str, Any]]) -> dict[str, Any]:
    away = np.hypot(places[:, 0] - track.place_x_m, places[:, 1] - track.y_m)
    nearest = int(away.argmin())
    near = away[nearest] <= WITHIN_M
    return {
        **plain(track),
        "truly": kinds[nearest] if near else "nothing",
        "true_volume_ml": rows[nearest]["volume_ml"] if near else None,
    }


def kept(out: Path, plan: ForeignPlan) -> dict[str, Any]:
    """What was measured on a belt, now where it is not in `out`."""
    path = out / f"{plan.name}.json"
    if not path.is_file():
        sys.stderr.write(f"{plan.name} ...\n")
        path.write_text(json.dumps(measured(plan)) + "\n", encoding="utf-8")
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found
