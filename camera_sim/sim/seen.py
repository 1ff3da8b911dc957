"""What a camera over a world measures: by errors that are drawn, or by matching two images."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from camera_sim.sim.matched import matched
from camera_sim.sim.presets import Preset
from camera_sim.sim.raster import Canvas, Window, whole_image
from camera_sim.sim.stereo import Field, NoiseBank, measure
from camera_sim.sim.world import CameraPose, World, heaved, own_frames, render


def measured(
    world: World,
    camera: CameraPose,
    preset: Preset,
    *,
    travel_m: float,
    time_s: float,
    unit_m: float,
    bank: NoiseBank,
    rng: Generator,
    bow: Field | None,
) -> tuple[Canvas, NDArray[np.uint16]]:
    """What is truly there, and (H, W) uint16 depth in units of `unit_m`, 0 = none.

    Args:
        travel_m: of the belt. time_s: of its heave. bank, bow: of errors that are drawn (`stereo.measure`).
    """
    canvas, k = render(world, camera, travel_m, time_s=time_s), camera.optics.intrinsics
    if preset.matching is None:
        true_m = (1 / canvas.inverse_depth).astype(np.float32)
        noise = preset.noise
        return canvas, measure(true_m, focal_px=k.fx, unit_m=unit_m, noise=noise, bank=bank, rng=rng, bow=bow)

    def show(aside_m: float, window: Window) -> Canvas:
        return render(world, camera, travel_m, time_s=time_s, window=window, aside_m=aside_m)

    depth = matched(
        show,
        own_frames(world, camera, travel_m, time_s=time_s),
        up=heaved(world, camera, time_s)[2, :3],
        belt_m=float(camera.believed_belt_from_camera[2, 3]),
        intrinsics=k,
        window=whole_image(k),
        unit_m=unit_m,
        matching=preset.matching,
        rng=rng,
    )
    return canvas, depth
