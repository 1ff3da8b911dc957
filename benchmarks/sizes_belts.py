"""Simulated belts for sizes: what the segmenter cuts out of them, what a regressor says of it, and the truth."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from benchmarks.options import chosen
from camera_sim.sim.conditions import KNOWN_BELT_SD_M, StatedRest
from camera_sim.sim.cultivars import STOCKS, Stock
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.scenes import Layout, SceneSettings, build_world, in_its_world, layout_named
from camera_sim.sim.source import simulated_sources, truth_of
from camera_sim.sim.tubers import draw_tuber
from conveyor.messages import Frame, Track, View, WeighedView
from conveyor.messages.base import plain
from conveyor.resting import RestingLevel
from regressor.weigh.prepare import RefusedCloud, prepare_view
from regressor.weigh.sizes import size_features
from regressor.weigh.viewscale import view_terms
from regressor.weigh.weigher import Weigher
from segmenter.pipeline import ClosedTrack, Segmenter, Settings

JUDGED = 58100
"""First seed of the belts that are judged on."""
WITHIN_M = 0.025
"""A track farther from a true place is no tuber's."""
DISTANCES_M = (0.36, 0.42, 0.46, 0.50)
SPEED_MPS, TRAINING_SPEED_MPS = 0.6, 1.0
"""Fewer frames a tuber for training: of each only three views are taken."""
SLENDER_BELTS = 20
"""Numbers of belts after the others; every second one is fitted on."""

MAYQUEEN = Stock(
    "MayQueen",
    "2023",
    50,
    (4.4928, 3.8703, 3.7272, 0.2093),
    (87590, 49140, 47590, 0, 34710, 32880, 0, 37420, 0, 5069),
    (1.066, 0.018),
    knobby=0.10,
)
"""Long tubers, as 50 were measured; in no training and no choice of this project."""
OBLONG = Stock(
    "oblong",
    "invented",
    0,
    (4.431, 4.127, 3.932, 0.170),
    (40000, 25500, 22400, 0, 22500, 18900, 0, 19600, 0, 6000),
    (1.080, 0.015),
    knobby=0.05,
)
"""Oblong and somewhat flat, between the round and the long ones: no tuber of it was measured."""

SLENDER = Stock(
    "slender",
    "invented",
    0,
    (4.55, 3.80, 3.68, 0.200),
    (46623, 28704, 23456, 3338, 27086, 20231, -1678, 20744, -3340, 7511),
    (1.068, 0.018),
    knobby=0.08,
)
"""Longer than any that was measured, 2.1 times as long as wide: for the fit alone, which else ends at 1.8."""

UNSEEN = (MAYQUEEN, OBLONG)
WORLDS = {
    "drawn": "",
    "clean": ", clean tubers",
    "known": ", clean tubers, known belt and scale",
}
"""What is left of a harsh recording's world: all; all but the soil on its tubers, which a camera sees and the true mesh
is without; its camera's noise and rim alone: its belt's level is stated as it is, and it measures at its true scale."""


@dataclass(frozen=True, slots=True)
class BeltPlan:
    """One belt: its scene, preset, seed and the kind of all its tubers."""

    name: str
    scene: str
    preset: str
    seed: int
    tubers: int
    stock: Stock
    distance_m: float
    world: str = "drawn"
    """Of `WORLDS`, for the preset 'harsh'."""


@dataclass(frozen=True, slots=True)
class Passed:
    """One tuber that was counted: its track with the answers of its views, and its truth.

    `features` are the views' (`sizes.FEATURES`), `terms` what they say of themselves (`viewscale.TERMS`).
    """

    track: Track
    features: tuple[tuple[float, ...], ...]
    terms: tuple[tuple[float, ...], ...]
    truth: dict[str, Any]


def fewer(plans: Sequence[Any], *, only: Sequence[int] | None, tubers: int | None) -> list[Any]:
    """Of the belts those with these numbers, from 0, and with so many tubers; a belt made smaller has another name."""
    found = chosen(plans, only)
    if tubers is None:
        return found
    return [replace(plan, name=f"{plan.name}-{tubers}", tubers=tubers) for plan in found]


def plans(which: str) -> list[BeltPlan]:
    """The belts of 'train' (cultivars of the simulator), 'check' (the same, other seeds) or 'judge' (unseen ones)."""
    if which == "judge":
        drawn = [
            BeltPlan(
                f"{stock.cultivar}-{preset}-{n}", "touching", preset, JUDGED + 100 * i + 10 * j + n, 75, stock, 0.46
            )
            for i, stock in enumerate(UNSEEN)
            for j, preset in enumerate(("field", "harsh"))
            for n in range(4)
        ]
        harsh = [plan for plan in drawn if plan.preset == "harsh"]
        others = [replace(plan, name=f"{plan.name}-{world}", world=world) for world in WORLDS for plan in harsh]
        return drawn + [plan for plan in others if plan.world != "drawn"]
    count, first = {"train": (84, 41000), "check": (28, 43000)}[which]
    # Odd numbers alone were fitted on and looked at: by them the shipped rules are made.
    presets = ("field", "harsh", "harsh", "field", "harsh", "easy", "field", "harsh", "harsh", "field")
    scenes = ("touching", "singulated", "touching", "crowded")
    stocks = [STOCKS[n % len(STOCKS)] for n in range(count)] + [SLENDER] * (SLENDER_BELTS if which == "train" else 0)
    return [
        BeltPlan(
            f"{which}-{n}",
            scenes[n % len(scenes)],
            presets[n % len(presets)],
            first + n,
            50,
            stocks[n],
            DISTANCES_M[n // 2 % len(DISTANCES_M)],
        )
        for n in range(1, len(stocks), 2)
    ]


def belt_settings(plan: BeltPlan) -> tuple[SceneSettings, Layout]:
    """What is simulated."""
    layout = layout_named(plan.scene)
    if plan.preset != "harsh":
        layout = replace(layout, one_tuber=lambda rng: draw_tuber(rng, level=3, stock=plan.stock))
    settings = in_its_world(
        SceneSettings(
            scene=plan.scene,
            seed=plan.seed,
            tubers=plan.tubers,
            preset=PRESETS[plan.preset],
            speed_mps=SPEED_MPS if plan.stock in UNSEEN else TRAINING_SPEED_MPS,
            belt_distance_m=plan.distance_m,
        ),
        layout,
    )
    if settings.conditions is not None:
        settings = _in_world(replace(settings, conditions=replace(settings.conditions, stock=plan.stock)), plan.world)
    return settings, layout


def _in_world(settings: SceneSettings, world: str) -> SceneSettings:
    """What of its drawn conditions the belt keeps, by `WORLDS`."""
    drawn = settings.conditions
    if world == "drawn" or drawn is None:
        return settings
    settings = replace(settings, conditions=(clean := replace(drawn, jacket_m=0.0)))
    if world == "clean":
        return settings
    true_scale = replace(clean.preset, noise=replace(clean.preset.noise, drift_px=0.0, scale=1.0))
    return replace(
        settings,
        preset=true_scale,
        conditions=replace(clean, preset=true_scale),
        stated=StatedRest(clean.resting_m, KNOWN_BELT_SD_M, calibrated=True),
    )


def segmented(
    settings: SceneSettings, layout: Layout
) -> tuple[list[ClosedTrack], list[Track], Segmenter, dict[str, Any]]:
    """(counted tracks, refused ones that are kept, their segmenter, truth) of the only camera of a scene."""
    world = build_world(settings, layout)
    (source,) = simulated_sources(world, settings, layout)
    stated = settings.stated
    resting = RestingLevel(offset_m=stated.offset_m, sd_m=stated.sd_m) if stated else RestingLevel()
    core = Segmenter(Settings(resting=resting))
    closed: list[ClosedTrack] = []
    foreign: list[Track] = []
    for frame in source.frames(run="sizes"):
        if isinstance(frame, Frame):
            result = core.step(frame)
            closed += result.closed
            foreign += result.foreign
    closed += core.finish()
    foreign += core.take_foreign()
    return closed, foreign, core, truth_of(world, [source])


def passed(plan: BeltPlan, weigher: Weigher) -> Iterator[Passed]:
    """The counted tubers of a belt that lie where a true one does, each true one once."""
    settings, layout = belt_settings(plan)
    closed, _, _, truth = segmented(settings, layout)
    places = np.array([(row["place_x_m"], row["place_y_m"]) for row in truth["tubers"]]).reshape(-1, 2)
    taken: set[int] = set()
    for track in closed:
        away = np.hypot(places[:, 0] - track.track.place_x_m, places[:, 1] - track.track.y_m)
        nearest = int(away.argmin())
        if away[nearest] > WITHIN_M or nearest in taken:
            continue
        taken.add(nearest)
        yield with_answers(track, truth["tubers"][nearest], weigher)


def with_answers(closed: ClosedTrack, truth: dict[str, Any], weigher: Weigher) -> Passed:
    """A counted track as it is logged, with what fits of its views are made from."""
    measured = [row for view in closed.views if (row := _measured(view, weigher)) is not None]
    track = replace(closed.track, views=tuple(row[0] for row in measured), views_sent=len(measured))
    return Passed(track, tuple(row[1] for row in measured), tuple(row[2] for row in measured), truth)


def _measured(view: View, weigher: Weigher) -> tuple[WeighedView, tuple[float, ...], tuple[float, ...]] | None:
    """A view's answer, its features and its terms; None where it is refused."""
    try:
        cloud = prepare_view(view)
    except RefusedCloud:
        return None
    said = weigher.weigh(cloud, belt_sd_m=view.belt_sd_m, resting_sd_m=view.resting_sd_m)
    level_sd_m = float(np.hypot(view.belt_sd_m, view.resting_sd_m))
    terms = view_terms(
        np.array([said.weight_g]),
        np.array([said.network_g or said.weight_g]),
        np.array([said.volume_g]),
        cloud.surface.as_array()[None],
        np.array([cloud.height_m]),
        np.array([level_sd_m]),
    )[0]
    answer = WeighedView(
        view_id=view.view_id,
        seq=view.seq,
        weight_g=said.weight_g,
        low_g=said.low_g,
        high_g=said.high_g,
        method=said.method,
        model=said.model,
        flags=said.flags,
        sizes=said.sizes,
    )
    return answer, tuple(size_features(cloud).tolist()), tuple(terms.tolist())


def kept(out: Path, plan: BeltPlan) -> list[Passed]:
    """The counted tubers of a belt, made now where they are not in `out`."""
    path = out / f"{plan.name}.json"
    if not path.is_file():
        sys.stderr.write(f"{plan.name} ...\n")
        rows = [plain(row) for row in passed(plan, Weigher.load())]
        path.write_text(json.dumps(rows) + "\n", encoding="utf-8")
    adapter = TypeAdapter(list[Passed])
    return adapter.validate_json(path.read_text(encoding="utf-8"))
