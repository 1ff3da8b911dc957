"""How hard the simulated world is: 'easy', 'field', a mix of both, or 'harsh', drawn for each recording.

'matched' has a camera whose depth is made of two images by a stereo matcher (`matched`), drawn for each recording.

'exact' is no harvester's: other simulators' cameras only round, and half of its shapes are of no cultivar. Weights that
were never shown such views read them several percent off.

The linear baseline of PointRAFT (box length, width, height) is off by 23.0 g on its 859 real tubers. On tubers of the
same seasons and refitted 20 times by tuber, it is off by 24-26 g on 'easy' and 30-33 g on 'field' (true axes: 22.5 g):
'easy' is about as hard for it as the real harvester's data, 'field' clearly harder. That compares one baseline only;
nothing here proves that a network trained on these views transfers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from numpy.random import Generator

from camera_sim.sim.matched import Matching
from camera_sim.sim.meshes import Vertices
from camera_sim.sim.poses import free_rotation, resting_rotation
from camera_sim.sim.stereo import EASY, EXACT, FIELD, StereoNoise
from conveyor.errors import InputError


@dataclass(frozen=True, slots=True)
class Preset:
    """One degree of difficulty.

    Attributes:
        free_share: share of tubers in any orientation: pushed, leaning on others, tumbling.
        patience_m: how much higher than the lowest a stable pose may be; see `resting_rotation`.
        roll_sd_deg: how far a tuber rolls while it rides through the view.
        belt_error_session_m, belt_error_tuber_m: sd of what the system believes of the belt distance, minus the truth.
        lift_sd_m: soil under the tuber and the belt's vibration.
        ragged_px: how far a mask's edge wanders from the tuber's.
        touched: share of views with a neighbour that touches.
        mask_px: by how many pixels masks are too large (below 0: too small); each is as likely.
        odd_share: share of tubers of a shape that no cultivar has; in single views only.
        matching: the camera matches two images, and `noise` says nothing but that it has neither scale nor drift.
    """

    name: str
    noise: StereoNoise
    free_share: float
    patience_m: float
    roll_sd_deg: float
    belt_error_session_m: float
    belt_error_tuber_m: float
    lift_sd_m: float
    ragged_px: float
    touched: float
    mask_px: tuple[int, ...] = (-2, -1, 0, 0, 0, 1)
    odd_share: float = 0.0
    matching: Matching | None = None

    @property
    def belt_sd_m(self) -> float:
        """How well the belt's height is known, standard deviation: what a line would write into its config."""
        return math.hypot(self.belt_error_session_m, self.belt_error_tuber_m)


EASY_PRESET = Preset("easy", EASY, 0.0, 0.002, 3.0, 0.0005, 0.0003, 0.0005, 0.7, 0.15)
FIELD_PRESET = Preset("field", FIELD, 0.25, 0.006, 30.0, 0.0020, 0.0015, 0.0010, 1.2, 0.30)
HARSH_PRESET = Preset("harsh", FIELD, 0.35, 0.006, 30.0, 0.0020, 0.0015, 0.0, 1.2, 0.30)
"""Poses, masks and belt errors of harsh recordings; camera, belt and cultivar come from `conditions`."""
EXACT_PRESET = Preset(
    "exact", EXACT, 0.25, 0.006, 30.0, 0.0005, 0.0, 0.0, ragged_px=0.0, touched=0.0, mask_px=(0,), odd_share=0.5
)
MATCHED_PRESET = Preset(
    "matched", EXACT, 0.25, 0.006, 30.0, 0.0005, 0.0003, 0.0005, 0.7, 0.15, odd_share=0.25, matching=Matching()
)
"""Poses between those of 'easy' and 'field'; the camera is drawn for each recording by `conditions`."""
PRESETS = {
    "easy": EASY_PRESET,
    "field": FIELD_PRESET,
    "harsh": HARSH_PRESET,
    "exact": EXACT_PRESET,
    "matched": MATCHED_PRESET,
}


def preset_named(name: str, rng: Generator) -> Preset:
    """The preset `name`; 'mixed' is either of the two, drawn from `rng`."""
    if name == "mixed":
        return FIELD_PRESET if rng.random() < 0.5 else EASY_PRESET
    if name not in PRESETS:
        raise InputError(f"preset '{name}' is unknown; known: {', '.join(PRESETS)}, mixed")
    return PRESETS[name]


def initial_rotation(vertices: Vertices, preset: Preset, rng: Generator) -> Vertices:
    """(3, 3) how a tuber with these vertices lies when it enters the view."""
    if rng.random() < preset.free_share:
        return free_rotation(rng)
    return resting_rotation(vertices, rng, patience_m=preset.patience_m)
