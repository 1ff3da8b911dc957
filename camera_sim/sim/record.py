"""Simulated lines as recordings on disk."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from camera_sim.sim.scenes import Layout, SceneSettings, build_world, layout_named
from camera_sim.sim.source import simulated_sources, truth_of
from camera_sim.sources.folder_writer import FolderWriter, write_line_file
from conveyor.messages import Frame

OnFrame = Callable[[int, int], None]
"""Called after each frame with how many are done and how many there will be."""


def record_scene(
    out: Path,
    settings: SceneSettings,
    *,
    layout: Layout | None = None,
    masks: bool = False,
    color: bool = False,
    faults: tuple[str, ...] = (),
    on_frame: OnFrame = lambda done, total: None,
) -> dict[str, Any]:
    """Write the scene of `settings` as a folder recording under `out`; returns its truth."""
    layout = layout or layout_named(settings.scene)
    world = build_world(settings, layout)
    sources = simulated_sources(world, settings, layout, masks=masks, color=color, faults=faults)
    total = sum(source.description.frames or 0 for source in sources)
    done = 0
    out.mkdir(parents=True, exist_ok=True)
    for source in sources:
        with FolderWriter(out, source.description) as writer:
            for frame in source.frames(run="simulated"):
                if isinstance(frame, Frame):
                    writer.write(frame)
                done += 1
                on_frame(done, total)
    write_line_file(out, [camera.name for camera in world.cameras], belt_speed_mps=settings.speed_mps)
    truth = truth_of(world, sources) | {
        "scene": settings.scene,
        "seed": settings.seed,
        "preset": settings.preset.name,
        "faults": list(faults),
    }
    (out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    return truth
