"""Random belts as a belt pack (`conveyor.formats.packs.belts`)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from camera_sim.sim.belt_scenes import BeltView, random_belt_views
from conveyor.formats.packs.belts import BeltPackWriter, PackedBelt, PackedFrame


def write_belt_pack(
    out: Path,
    *,
    belts: int,
    frames: int,
    tubers: int,
    seed: int,
    command: str,
    hard_negatives: bool = False,
    matched: float = 0.0,
    on_belt: Callable[[int], None] = lambda _: None,
) -> int:
    """Simulate `belts` belts and write `frames` frames of each under `out`; returns how many frames were made."""
    meta = {"command": command, "seed": seed, "tubers_per_belt": tubers, "hard_negatives": hard_negatives}
    if matched > 0:
        meta["matched"] = matched
    with BeltPackWriter(out, meta=meta) as writer:
        for belt in range(belts):
            views = random_belt_views(
                seed, belt, frames=frames, tubers=tubers, hard_negatives=hard_negatives, matched=matched
            )
            writer.add(_packed(list(views)))
            on_belt(belt)
    return writer.frames


def _packed(views: list[BeltView]) -> PackedBelt:
    first = views[0]
    return PackedBelt(
        intrinsics=first.intrinsics,
        belt_from_camera=first.belt_from_camera,
        depth_scale_m=first.depth_scale_m,
        kinds=first.kinds,
        frames=tuple(PackedFrame(view.depth, view.labels, view.travel_m) for view in views),
    )
