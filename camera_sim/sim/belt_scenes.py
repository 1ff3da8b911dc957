"""Belts drawn at random in everything that varies between harvesters: to train a classifier for more than one belt."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from camera_sim.sim.belt import draw_belt
from camera_sim.sim.conditions import Conditions, draw_conditions, draw_tuber_of
from camera_sim.sim.cultivars import Relief, draw_recipe
from camera_sim.sim.distractors import draw_hard_negative
from camera_sim.sim.optics import D405_848, D405_1280
from camera_sim.sim.placement import CROWDED, SINGULATED, TOUCHING
from camera_sim.sim.presets import EASY_PRESET, EXACT_PRESET, FIELD_PRESET, Preset
from camera_sim.sim.scenes import Layout, SceneSettings, belt_tuber, build_world
from camera_sim.sim.seen import measured
from camera_sim.sim.stereo import Field, NoiseBank
from camera_sim.sim.stereo_faults import bowed_field
from camera_sim.sim.tubers import Tuber, draw_odd_tuber, grow
from camera_sim.sim.world import Body, CameraPose, World
from conveyor.geometry import Intrinsics

DISTANCE_M = (0.30, 0.60)
MOST_TILT_DEG = 4.0
MOST_NOISE = 2.5
STEP_M = (0.015, 0.040)
LOOK_STEP_M = (0.011, 0.021)
"""Up to twice the segmenter's way between two looks at a track: a training draws some of them anyway."""
RESTLESS = 0.4
"""Share of belts of hard negatives whose load rocks, slides and rolls, up to the strength of the scene `rolling`."""
HARSH_SHARE, EXACT_SHARE = 0.5, 0.1
"""Shares of belts of hard negatives whose camera, surface, resting level, cultivar and soil are those of `harsh`, and
whose camera only rounds while half of their tubers have shapes of no cultivar, as those of other simulators."""
HARD_SHARE, BUMPY_SHARE, SMALL_ML, KNOBBY = 0.5, 0.5, 90.0, 0.25
"""Share of tubers that are hard to tell from clods, and of these that are bumpy; the others are drawn until one is
smaller than this, or has stronger second growth than this."""
BUMPY_RMS, BUMPY_FINEST, BUMPY_FALL = (0.03, 0.08), (6.0, 13.0), (0.5, 1.5)
"""Relief of bumpy tubers, up to four times that of ordinary ones: broad, as tubers that stopped and went on growing
have it."""


@dataclass(frozen=True, slots=True)
class BeltView:
    """One frame of a random belt.

    Attributes:
        depth: (H, W) uint16, units of `depth_scale_m` metres, 0 = none.
        labels: (H, W) uint16, body numbers as rendered, 0 = belt; also where `depth` is 0.
        kinds: kind of body number n + 1.
        belt_from_camera: (4, 4) as the calibration says, with its error.
        travel_m: how far the belt had moved.
    """

    depth: NDArray[np.uint16]
    labels: NDArray[np.uint16]
    kinds: tuple[str, ...]
    depth_scale_m: float
    intrinsics: Intrinsics
    belt_from_camera: NDArray[np.float64]
    travel_m: float


def random_belt_views(
    seed: int, number: int, *, frames: int, tubers: int, hard_negatives: bool = False, matched: float = 0.0
) -> Iterator[BeltView]:
    """`frames` views of belt `number` of `seed`, while its middle passes; a belt is the same whenever drawn.

    `hard_negatives`: every other body is a clod or a stone of a tuber's size, small, knobby and bumpy tubers are
    frequent, views are about as far apart as the segmenter's looks, half of the belts are of the world `harsh`, one in
    ten of `exact`.

    `matched`: share of these belts whose camera matches two images instead (`camera_sim.sim.matched`).
    """
    rng = np.random.default_rng([seed, 40, number])
    drawn = partial(hard_negative_settings, matched=matched) if hard_negatives else _settings
    settings, layout = drawn(rng, seed=int(rng.integers(2**31)), tubers=tubers)
    world = build_world(settings, layout)
    if settings.conditions is None:
        relief = draw_belt(
            rng,
            soil_m=rng.uniform(0.0004, 0.003),
            cleat_m=rng.uniform(0.0, 0.010),
            pitch_mm=int(rng.choice(np.array([32, 64, 128]))),
        )
        world = replace(world, belt=relief)
    camera = world.cameras[0]
    k = camera.optics.intrinsics
    bank = NoiseBank(rng, height=k.height, width=k.width)
    bow = bowed_field(rng, height=k.height, width=k.width) if settings.preset.noise.bow_px else None
    places = [body.place[0] for body in world.bodies]
    middle_m = camera.belt_from_camera[0, 3] - (max(places) + min(places)) / 2
    step_m = rng.uniform(*(LOOK_STEP_M if hard_negatives else STEP_M))
    for n in range(frames):
        travel_m = middle_m + (n - (frames - 1) / 2) * step_m + rng.uniform(-0.005, 0.005)
        yield _view(world, camera, settings, bank, bow, rng, travel_m=travel_m)


def _settings(rng: Generator, *, seed: int, tubers: int) -> tuple[SceneSettings, Layout]:
    half = rng.uniform(0.30, 0.52)
    layout = Layout(
        packing=(SINGULATED, TOUCHING, CROWDED)[int(rng.choice(3, p=[0.25, 0.45, 0.30]))],
        lanes_m=((-half, half),),
        distractors=float(rng.choice(np.array([0.0, 0.4, 0.8, 1.5]), p=[0.1, 0.3, 0.35, 0.25])),
        tilt_deg=(rng.uniform(-MOST_TILT_DEG, MOST_TILT_DEG), rng.uniform(-MOST_TILT_DEG, MOST_TILT_DEG)),
    )
    settings = SceneSettings(
        scene="random",
        seed=seed,
        tubers=tubers,
        preset=_noisier(FIELD_PRESET if rng.random() < 0.5 else EASY_PRESET, rng),
        optics=D405_1280 if rng.random() < 0.4 else D405_848,
        belt_distance_m=rng.uniform(*DISTANCE_M),
        unit_m=0.0001 if rng.random() < 0.2 else 0.001,
    )
    return settings, layout


def hard_negative_settings(
    rng: Generator, *, seed: int, tubers: int, matched: float = 0.0
) -> tuple[SceneSettings, Layout]:
    """A belt for the classifier, every other body a clod or a stone; half of the draws are of the world `harsh`, one in
    ten of `exact`, and of all the share `matched` has a camera of that preset instead.
    """
    half, which = rng.uniform(0.30, 0.52), rng.random()
    two_images = matched > 0 and np.random.default_rng([seed, 41]).random() < matched
    harsh = draw_conditions("harsh", rng) if which < HARSH_SHARE and not two_images else None
    one_tuber: Callable[[Generator], Tuber] = _often_hard
    if two_images:
        preset, one_tuber = draw_conditions("matched", rng).preset, _often_odd
    elif harsh is not None:
        preset, one_tuber = harsh.preset, partial(_often_hard_of, harsh)
    elif which < HARSH_SHARE + EXACT_SHARE:
        preset, one_tuber = EXACT_PRESET, _often_odd
    else:
        preset = FIELD_PRESET if rng.random() < 0.5 else EASY_PRESET
        preset = _noisier(preset, rng) if rng.random() < 0.4 else preset
    layout = Layout(
        packing=(SINGULATED, TOUCHING, CROWDED)[int(rng.choice(3, p=[0.15, 0.60, 0.25]))],
        lanes_m=((-half, half),),
        distractors=1.0,
        one_tuber=one_tuber,
        one_distractor=draw_hard_negative,
        tilt_deg=(rng.uniform(-MOST_TILT_DEG, MOST_TILT_DEG), rng.uniform(-MOST_TILT_DEG, MOST_TILT_DEG)),
    )
    settings = SceneSettings(
        scene="random",
        seed=seed,
        tubers=tubers,
        preset=preset,
        optics=D405_1280 if rng.random() < 0.2 else D405_848,
        belt_distance_m=float(rng.triangular(DISTANCE_M[0], 0.46, DISTANCE_M[1])),
        unit_m=0.0001 if rng.random() < 0.2 else 0.001,
        unrest=rng.uniform(0, 1) if rng.random() < RESTLESS else 0.0,
        conditions=harsh,
        heave_mm=0.0 if harsh is None else harsh.heave_m * 1000,
        heave_hz=4.0 if harsh is None else harsh.heave_hz,
    )
    return settings, layout


def _often_hard(rng: Generator) -> Tuber:
    """A tuber; often one of those that are taken for clods."""
    return _hard(rng) if rng.random() < HARD_SHARE else belt_tuber(rng)


def _hard(rng: Generator) -> Tuber:
    """A tuber that is bumpy, small or has second growth."""
    recipe = draw_recipe(rng)
    if rng.random() < BUMPY_SHARE:
        bumps = Relief(rng.uniform(*BUMPY_RMS), finest=rng.uniform(*BUMPY_FINEST), fall=rng.uniform(*BUMPY_FALL))
        return grow(replace(recipe, relief=bumps), rng, level=3)
    while recipe.volume_ml > SMALL_ML and recipe.knobs < KNOBBY:
        recipe = draw_recipe(rng)
    return grow(recipe, rng, level=3)


def _often_hard_of(conditions: Conditions, rng: Generator) -> Tuber:
    """A tuber of a recording with a world of its own; often one of those that are taken for clods."""
    return draw_tuber_of(conditions, rng, level=3, draw=_hard if rng.random() < HARD_SHARE else None)


def _often_odd(rng: Generator) -> Tuber:
    """A tuber; half of them have a shape that no cultivar has."""
    return draw_odd_tuber(rng, level=3) if rng.random() < EXACT_PRESET.odd_share else _often_hard(rng)


def _noisier(preset: Preset, rng: Generator) -> Preset:
    """The preset with its smooth, correlated and white noise up to `MOST_NOISE` times as strong."""
    by = rng.uniform(1.0, MOST_NOISE) if rng.random() < 0.6 else 1.0
    n = preset.noise
    noise = replace(n, fine_px=n.fine_px * by, mid_px=n.mid_px * by, smooth_px=n.smooth_px * by)
    return replace(preset, noise=noise)


def _view(
    world: World,
    camera: CameraPose,
    settings: SceneSettings,
    bank: NoiseBank,
    bow: Field | None,
    rng: Generator,
    *,
    travel_m: float,
) -> BeltView:
    canvas, depth = measured(
        world,
        camera,
        settings.preset,
        travel_m=travel_m,
        time_s=travel_m / settings.speed_mps,
        unit_m=settings.unit_m,
        bank=bank,
        rng=rng,
        bow=bow,
    )
    return BeltView(
        depth=depth,
        labels=canvas.ids.astype(np.uint16),
        kinds=_kinds(world.bodies),
        depth_scale_m=settings.unit_m,
        intrinsics=camera.optics.intrinsics,
        belt_from_camera=camera.believed_belt_from_camera,
        travel_m=travel_m,
    )


def _kinds(bodies: tuple[Body, ...]) -> tuple[str, ...]:
    return tuple(body.kind for body in sorted(bodies, key=lambda body: body.body_id))
