"""What one recording's world is: its camera, its belt, its cultivar. All tubers of the recording share it, as in life.

The ranges of 'harsh' span what real belts and cameras showed; docs/worlds.md has them with their units and sources.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from camera_sim.sim.cultivars import Stock, draw_stock
from camera_sim.sim.lowering import typical_sink_m
from camera_sim.sim.matched import Matching
from camera_sim.sim.optics import BASELINE_M
from camera_sim.sim.presets import HARSH_PRESET, MATCHED_PRESET, PRESETS, Preset
from camera_sim.sim.rods import Rods
from camera_sim.sim.stereo import StereoNoise
from camera_sim.sim.surface import FLAT, Surface
from camera_sim.sim.tubers import LEVEL, Tuber, draw_tuber, with_jacket
from conveyor.camera_range import CAMERAS, Range
from conveyor.errors import InputError

HARSH = CAMERAS["harsh"]
"""What weights that were trained in this world are compared with; the rest of a camera is not measured on frames."""

LOCAL_PX = HARSH.local_px
FINE_SHARE, MID_SHARE, ROUNDING_PX = 0.97, 0.8, 1 / 32 / 12**0.5
"""Fine and mid noise of a camera whose residual to an 11 x 11 quadric is 1 px; rounding alone leaves 0.009 px."""
SMOOTH_PX = HARSH.smooth_px
BOW_PX = HARSH.bow_px
ISLANDS = HARSH.islands
RIM_PX: Range = (0.2, 2.5)
SHARP_SHARE = 0.35
"""Share of cameras that lose nothing at rims and flanks beyond what the matching window does."""
OUTLINE_PX = HARSH.outline_px
STEEP: Range = (0.20, 0.90)
BARE = HARSH.bare
BLOBS_PX = (2, 5)
SCALE: Range = (0.99, 1.01)
DRIFT_PX: Range = (-0.4, 0.4)
EDGE_PX: Range = (0.8, 1.8)
RAGGED_PX: Range = (0.2, 1.5)
MASKS_PX = ((0,), (1,), (0, 0, 1), (-1, 0, 0), (-2, -1, 0, 0, 0, 1))
"""Masks are off in a way of each recording: not at all, too large, either, too small, or as in other presets."""

SURFACES = {"flat": 0.35, "rods": 0.30, "cleats": 0.15, "sagging": 0.20}
ROD_MM = (10.5, 12.0)
PITCH_MM = (28, 30, 32, 34, 36, 38, 40, 45, 50)
BELOW_M: Range = (0.03, 0.15)
CLEAT_M: Range = (0.004, 0.010)
CLEAT_PITCH_MM = (64, 128)
SAG_M: Range = (0.002, 0.010)
SOIL_M = HARSH.soil_m
RESTING_M: Range = (-0.002, 0.009)
BEYOND_RODS_M: Range = (-0.002, 0.003)
"""What is added on rods to the sink that their geometry gives; the sum stays within RESTING_M."""
SCATTER_M: Range = (0.0003, 0.0015)
JACKET_SHARE, JACKET_M = 0.5, (0.0002, 0.0015)
HEAVE_SHARE, HEAVE_M, HEAVE_HZ = 0.5, (0.0002, 0.003), (2.0, 6.0)

CALIBRATED_SHARE = 0.6
CALIBRATED_SD_M: Range = (0.0003, 0.0015)
UNKNOWN_SD_M, KNOWN_RODS_SD_M = 0.0047, 0.0016
"""Root mean square of what is not known: of RESTING_M about 0, and of BEYOND_RODS_M about the geometry's sink."""
KNOWN_BELT_SD_M = 0.0005
"""Stated of a simulated belt whose resting offset was chosen: the scatter from tuber to tuber is not in it."""

WORLDS = {"easy": 0.25, "field": 0.35, "harsh": 0.40}
"""Shares of recordings in the mixture 'worlds'."""


@dataclass(frozen=True, slots=True)
class StatedRest:
    """What the user of a recording would state: undersides `offset_m` below the belt plane, with that sd."""

    offset_m: float
    sd_m: float
    calibrated: bool


@dataclass(frozen=True, slots=True)
class Conditions:
    """One recording's world.

    Attributes:
        preset: its degree of difficulty, with this recording's camera as `preset.noise`.
        surface: what tubers lie on.
        resting_m: how far undersides lie below the belt plane that the camera sees, for its ordinary tubers.
        beyond_m: what of that the surface's geometry does not explain; each tuber's own is geometry + this.
        scatter_m: sd of each tuber's own level about that: soil under it, play between rods, vibration.
        jacket_m: mean thickness of soil that sticks to tubers.
        stock: the cultivar and season of all tubers; None: any.
        heave_m, heave_hz: amplitude and frequency at which belt and load move up and down under the camera.
        soil_m: rms of the belt's soil; None: as the preset has it.
        local_px: residual of the depth to an 11 x 11 quadric, pixels of disparity; None: as the preset has it.
    """

    preset: Preset
    surface: Surface = FLAT
    resting_m: float = 0.0
    beyond_m: float = 0.0
    scatter_m: float = 0.0
    jacket_m: float = 0.0
    stock: Stock | None = None
    heave_m: float = 0.0
    heave_hz: float = 4.0
    soil_m: float | None = None
    local_px: float | None = None


def draw_conditions(name: str, rng: Generator) -> Conditions:
    """The world of a recording of the preset `name`; 'worlds' draws the preset too. All tubers are of one cultivar, but
    for those of 'matched'.
    """
    if name == "worlds":
        name = str(rng.choice(np.array(list(WORLDS)), p=np.array(list(WORLDS.values()))))
    if name not in PRESETS:
        raise InputError(f"preset '{name}' is unknown; known: {', '.join(PRESETS)}, worlds")
    if name == "matched":
        return Conditions(replace(MATCHED_PRESET, matching=draw_matching(rng)))
    stock = draw_stock(rng)
    if name != "harsh":
        return Conditions(PRESETS[name], stock=stock)
    local_px = _log_uniform(rng, LOCAL_PX)
    surface = _surface(rng)
    support = surface.support
    sink_m = typical_sink_m(support, stock.typical_axes_mm) if support is not None else 0.0
    if surface.kind == "rods":
        resting_m = float(np.clip(sink_m + rng.uniform(*BEYOND_RODS_M), *RESTING_M))
    else:
        resting_m = float(rng.uniform(*RESTING_M))
    return Conditions(
        preset=replace(
            HARSH_PRESET,
            noise=_camera(rng, local_px),
            ragged_px=float(rng.uniform(*RAGGED_PX)),
            mask_px=MASKS_PX[int(rng.integers(len(MASKS_PX)))],
        ),
        surface=surface,
        resting_m=resting_m,
        beyond_m=resting_m - sink_m,
        scatter_m=float(rng.uniform(*SCATTER_M)),
        jacket_m=float(rng.uniform(*JACKET_M)) if rng.random() < JACKET_SHARE else 0.0,
        stock=stock,
        heave_m=float(rng.uniform(*HEAVE_M)) if rng.random() < HEAVE_SHARE else 0.0,
        heave_hz=float(rng.uniform(*HEAVE_HZ)),
        soil_m=float(rng.uniform(*SOIL_M)),
        local_px=local_px,
    )


def draw_matching(rng: Generator) -> Matching:
    """A camera of 'matched': most with a D405's baseline, the others with up to three times it."""
    return Matching(
        baseline_m=BASELINE_M if rng.random() < 0.6 else float(rng.uniform(0.025, 0.055)),
        window_px=int(rng.choice(np.array([9, 11, 13, 15, 17, 21, 25]))),
        semi_global=bool(rng.random() < 0.35),
        unlike_percent=int(rng.integers(3, 16)),
        contrast=_log_uniform(rng, (0.10, 0.40)),
        noise=float(rng.uniform(0.7, 2.5)),
        mark_px=float(rng.uniform(1.3, 2.6)),
        texture=int(rng.integers(2**31)),
    )


def draw_tuber_of(
    conditions: Conditions, rng: Generator, *, level: int = LEVEL, draw: Callable[[Generator], Tuber] | None = None
) -> Tuber:
    """A tuber of the recording: of its cultivar or as `draw` draws one, not so slim that it falls through the
    recording's rods, under its soil.
    """
    rods = conditions.surface.rods
    while True:
        tuber = draw_tuber(rng, level=level, stock=conditions.stock) if draw is None else draw(rng)
        if rods is None or tuber.axes_mm[1] > 1000 * rods.gap_m:
            return with_jacket(tuber, rng, mean_m=conditions.jacket_m) if conditions.jacket_m > 0 else tuber


def draw_stated(conditions: Conditions, rng: Generator) -> StatedRest:
    """What a user states of the recording's resting offset, after a calibration or without."""
    calibrated = bool(rng.random() < CALIBRATED_SHARE)
    sd_m = _log_uniform(rng, CALIBRATED_SD_M)
    error_m = sd_m * float(rng.standard_normal())
    if calibrated:
        return StatedRest(conditions.resting_m + error_m, sd_m, calibrated=True)
    if conditions.surface.kind == "rods":
        return StatedRest(conditions.resting_m - conditions.beyond_m, KNOWN_RODS_SD_M, calibrated=False)
    return StatedRest(0.0, UNKNOWN_SD_M, calibrated=False)


def _camera(rng: Generator, local_px: float) -> StereoNoise:
    beside_rounding_px = (local_px**2 - ROUNDING_PX**2) ** 0.5
    sharp = rng.random() < SHARP_SHARE
    rim_px, steep = _log_uniform(rng, RIM_PX), _log_uniform(rng, STEEP)
    return StereoNoise(
        fine_px=FINE_SHARE * beside_rounding_px,
        mid_px=MID_SHARE * beside_rounding_px,
        smooth_px=_log_uniform(rng, SMOOTH_PX),
        edge_px=float(rng.uniform(*EDGE_PX)),
        steep=STEEP[1] if sharp else steep,
        bare=_log_uniform(rng, BARE),
        bow_px=float(rng.uniform(*BOW_PX)),
        drift_px=float(rng.uniform(*DRIFT_PX)),
        scale=float(rng.uniform(*SCALE)),
        islands=_log_uniform(rng, ISLANDS),
        rim_px=0.0 if sharp else rim_px,
        outline_px=_log_uniform(rng, OUTLINE_PX) - rim_px,
        blob_px=int(rng.choice(np.array(BLOBS_PX))),
    )


def _surface(rng: Generator) -> Surface:
    kind = str(rng.choice(np.array(list(SURFACES)), p=np.array(list(SURFACES.values()))))
    if kind == "rods":
        diameter_m, pitch_m = float(rng.choice(np.array(ROD_MM))) / 1000, float(rng.choice(np.array(PITCH_MM))) / 1000
        return Surface("rods", rods=Rods(diameter_m / 2, pitch_m, float(rng.uniform(*BELOW_M))))
    if kind == "cleats":
        pitch_mm = int(rng.choice(np.array(CLEAT_PITCH_MM)))
        return Surface("cleats", cleat_m=float(rng.uniform(*CLEAT_M)), cleat_pitch_mm=pitch_mm)
    return Surface("sagging", sag_m=float(rng.uniform(*SAG_M))) if kind == "sagging" else FLAT


def _log_uniform(rng: Generator, limits: Range) -> float:
    return float(np.exp(rng.uniform(np.log(limits[0]), np.log(limits[1]))))
