"""Camera, belt and cultivar over which single views are made: by tuber for the old presets, else by recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from camera_sim.sim.belt import Belt
from camera_sim.sim.conditions import Conditions, StatedRest, draw_conditions, draw_stated
from camera_sim.sim.optics import D405_848, D405_1280, Optics
from camera_sim.sim.presets import Preset, preset_named
from camera_sim.sim.stereo import Field
from camera_sim.sim.stereo_faults import bowed_field

SEASON_DISTANCES_M = (0.345, 0.460, 0.465)
TUBERS_PER_RECORDING = 25
BELT_ERRORS = (0.8, 0.6)
"""Shares of a belt's standard deviation, of what all tubers of a recording have in common and of each one's own."""
BY_RECORDING = ("harsh", "worlds", "matched")
"""Presets whose camera and belt, and but for 'matched' cultivar, are shared by all tubers of a recording."""


@dataclass(frozen=True, slots=True)
class ViewPlan:
    """What a pack of views shall hold.

    Attributes:
        preset: 'easy', 'field', 'harsh', 'exact', 'matched', 'mixed' (easy or field by tuber) or 'worlds' (easy, field
            or harsh by recording).
        optics: None is either D405 resolution.
        belt_sds_m: how well belts are known, standard deviations, of which each recording has one; without any as the
            preset has it.
    """

    seed: int
    views_per_tuber: int
    preset: str
    optics: Optics | None = None
    distances_m: tuple[float, ...] = SEASON_DISTANCES_M
    distance_range_m: tuple[float, float] | None = None
    fine_unit_share: float = 0.0
    clipped_share: float = 0.03
    belt_sds_m: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Recording:
    """What the tubers of one recording share.

    Attributes:
        session_error: of the believed belt distance, in standard deviations of the preset's.
        belt_sd_m: how well the belt distance is known; None: as the preset has it.
        conditions, optics, unit_m, distance_m, belt, bow: None where each tuber has its own.
    """

    number: int
    session_error: float
    stated: StatedRest
    conditions: Conditions | None = None
    optics: Optics | None = None
    unit_m: float = 0.001
    distance_m: float = 0.0
    belt: Belt | None = None
    bow: Field | None = None
    belt_sd_m: float | None = None


@dataclass(frozen=True, slots=True)
class Setting:
    """The camera over the belt during one tuber's ride.

    Attributes:
        believed_distance_m: the belt distance as the system believes it.
        seen_distance_m: the one that the camera sees; they differ by the preset's error.
        true_distance_m: the real one: they differ by the camera's drift and scale.
        bow: (H, W) the camera's bowed field, unit variance.
    """

    recording: Recording
    conditions: Conditions
    optics: Optics
    unit_m: float
    true_distance_m: float
    seen_distance_m: float
    believed_distance_m: float
    belt: Belt
    bow: Field | None = None

    @property
    def preset(self) -> Preset:
        """Its degree of difficulty, with the camera's noise."""
        return self.conditions.preset


def draw_recording(plan: ViewPlan, number: int) -> Recording:
    """Recording `number` of a plan, the same whatever was drawn before."""
    session_error = float(np.random.default_rng([plan.seed, 2, number]).standard_normal())
    rng = np.random.default_rng([plan.seed, 3, number])
    belt_sd_m = None
    if plan.belt_sds_m:
        belt_sd_m = float(np.random.default_rng([plan.seed, 4, number]).choice(np.asarray(plan.belt_sds_m)))
    if plan.preset not in BY_RECORDING:
        flat = Conditions(preset_named(plan.preset, rng))
        return Recording(number, session_error, draw_stated(flat, rng), belt_sd_m=belt_sd_m)
    conditions = _known_to(draw_conditions(plan.preset, rng), belt_sd_m)
    stated = draw_stated(conditions, rng)
    optics, distance_m, unit_m = _optics(plan, rng), _distance_m(plan, rng), _unit_m(plan, rng)
    soil_m = conditions.soil_m if conditions.soil_m is not None else float(rng.choice(np.array([8e-4, 2e-3])))
    belt = conditions.surface.belt(rng, soil_m=soil_m)
    bow = None
    if conditions.preset.noise.bow_px > 0:
        bow = bowed_field(rng, height=optics.intrinsics.height, width=optics.intrinsics.width)
    return Recording(number, session_error, stated, conditions, optics, unit_m, distance_m, belt, bow, belt_sd_m)


def _known_to(conditions: Conditions, belt_sd_m: float | None) -> Conditions:
    """The same where the belt distance is known to `belt_sd_m`, most of it shared by the recording; None: as it is."""
    if belt_sd_m is None:
        return conditions
    session_m, tuber_m = BELT_ERRORS[0] * belt_sd_m, BELT_ERRORS[1] * belt_sd_m
    preset = replace(conditions.preset, belt_error_session_m=session_m, belt_error_tuber_m=tuber_m)
    return replace(conditions, preset=preset)


def draw_setting(plan: ViewPlan, recording: Recording, belts: list[Belt], rng: Generator) -> Setting:
    """The setting of the next tuber of `recording`; where that shares nothing, all of it is drawn from `rng`."""
    if recording.conditions is not None and recording.optics is not None and recording.belt is not None:
        conditions, optics, unit_m = recording.conditions, recording.optics, recording.unit_m
        believed_m, belt, bow = recording.distance_m, recording.belt, recording.bow
        error_m = _belt_error_m(conditions.preset, recording.session_error, rng)
    else:
        conditions = _known_to(Conditions(preset_named(plan.preset, rng)), recording.belt_sd_m)
        optics, believed_m = _optics(plan, rng), _distance_m(plan, rng)
        error_m = _belt_error_m(conditions.preset, recording.session_error, rng)
        unit_m = _unit_m(plan, rng)
        belt, bow = belts[int(rng.random() < 0.6)], None
    seen_m = believed_m - error_m
    noise = conditions.preset.noise
    plain = noise.drift_px == 0 and noise.scale == 1
    true_m = seen_m if plain else noise.true_m(seen_m, focal_px=optics.intrinsics.fx)
    return Setting(recording, conditions, optics, unit_m, true_m, seen_m, believed_m, belt, bow)


def _optics(plan: ViewPlan, rng: Generator) -> Optics:
    return plan.optics or (D405_1280 if rng.random() < 0.6 else D405_848)


def _distance_m(plan: ViewPlan, rng: Generator) -> float:
    distance_m = float(rng.choice(np.asarray(plan.distances_m)))
    if plan.distance_range_m is not None and rng.random() < 0.4:
        distance_m = float(rng.uniform(*plan.distance_range_m))
    return distance_m


def _unit_m(plan: ViewPlan, rng: Generator) -> float:
    return 1e-4 if rng.random() < plan.fine_unit_share else 1e-3


def _belt_error_m(preset: Preset, session_error: float, rng: Generator) -> float:
    return preset.belt_error_session_m * session_error + preset.belt_error_tuber_m * float(rng.standard_normal())
