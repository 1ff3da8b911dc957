"""Worse worlds and cameras by name: what `--inject` changes before anything is rendered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from camera_sim.sim.scenes import SceneSettings
from camera_sim.sim.stereo import StereoNoise
from conveyor.errors import InputError

NOISE: dict[str, Callable[[StereoNoise], StereoNoise]] = {
    "coarse-disparity": lambda noise: replace(noise, steps_per_px=8),
    "fine-noise": lambda noise: replace(noise, fine_px=4 * noise.fine_px, mid_px=4 * noise.mid_px),
    "smooth-error": lambda noise: replace(noise, smooth_px=3 * noise.smooth_px),
    "ragged-edges": lambda noise: replace(noise, edge_px=3 * noise.edge_px),
    "steep-holes": lambda noise: replace(noise, steep=0.5 * noise.steep),
    "holes": lambda noise: replace(noise, bare=0.03),
}
"""Steps of 1/8 px instead of 1/32; noise of 4 and smooth error of 3 times the D405's; edges that wander 3 times as far;
flanks missing from half the steepness on; 3 % of the surface without texture."""

WORLD: dict[str, Callable[[SceneSettings], SceneSettings]] = {
    "belt-jitter": lambda settings: replace(settings, jitter=15.0),
    "rolling": lambda settings: replace(settings, unrest=max(settings.unrest, 1.0)),
    "fine-unit": lambda settings: replace(settings, unit_m=0.0001),
    "wrong-scale": lambda settings: replace(settings, unit_m=0.0001, claimed_unit_m=0.001),
    "depth-drift": lambda settings: replace(settings, drift_by_end_px=0.4),
    "mount-moves": lambda settings: replace(settings, shift_by_end_mm=6.0),
}
"""A belt whose speed swings by 10 % either way twice a second; tubers that rock and roll; depth in the D405's own
0.1 mm; the same, but the recording claims 1 mm; a disparity that grows by 0.4 px, and a camera that moves away by
6 mm, evenly from the first frame to the last."""


def worsened(settings: SceneSettings, names: tuple[str, ...]) -> SceneSettings:
    """The settings with all named changes; names of other kinds change nothing here.

    Raises:
        InputError: errors are to be drawn worse of a camera whose errors are not drawn.
    """
    for name in names:
        if settings.preset.matching is not None and (name in NOISE or name == "depth-drift"):
            raise InputError(
                f"--inject {name} changes errors that are drawn, and those of --preset matched come of matching two "
                "images; choose easy, field or harsh for it"
            )
        if name in NOISE:
            noise = NOISE[name](settings.preset.noise)
            settings = replace(settings, preset=replace(settings.preset, noise=noise))
        if name in WORLD:
            settings = WORLD[name](settings)
    return settings
