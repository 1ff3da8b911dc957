"""Simulated lines as recordings on disk."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from camera_sim.sim.conditions import Conditions
from camera_sim.sim.scenes import Layout, SceneSettings, build_world, in_its_world, layout_named
from camera_sim.sim.source import SimulatedSource, simulated_sources, truth_of
from camera_sim.sim.worse import worsened
from conveyor.formats.folder.writer import FolderWriter, line_file
from conveyor.formats.mcap.writer import McapFrameWriter
from conveyor.formats.merged import in_time
from conveyor.formats.target import TargetFormat, target_format
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
    form: TargetFormat = "auto",
    on_frame: OnFrame = lambda done, total: None,
) -> dict[str, Any]:
    """Write the scene of `settings` to `out`, an MCAP file where it ends in .mcap, else a folder; returns its truth.

    The truth goes to `<out>/truth.json`, or beside an MCAP file to `<name>.truth.json`.
    """
    layout = layout or layout_named(settings.scene)
    settings = worsened(in_its_world(settings, layout), faults)
    world = build_world(settings, layout)
    sources = simulated_sources(world, settings, layout, masks=masks, color=color, faults=faults)
    truth = truth_of(world, sources) | {
        "scene": settings.scene,
        "seed": settings.seed,
        "preset": settings.preset.name,
        "faults": list(faults),
    }
    if settings.preset.matching is not None:
        truth["matching"] = asdict(settings.preset.matching)
    truth |= world_truth(settings, layout)
    cameras = [camera.name for camera in world.cameras]
    texts = {"truth.json": as_text(truth), "line.json": as_text(line_file(cameras, belt_speed_mps=settings.speed_mps))}
    write = {"folder": write_folder, "mcap": _write_mcap, "ros2": _write_ros2}[target_format(out, form)]
    write(out, sources, texts, on_frame)
    return truth


def world_truth(settings: SceneSettings, layout: Layout) -> dict[str, Any]:
    """What truth.json says of the recording's world beside its load; nothing where tubers lie on a flat belt."""
    truth: dict[str, Any] = {}
    if settings.heave_mm > 0:
        truth = {"heave_mm": round(settings.heave_mm, 3), "heave_hz": round(settings.heave_hz, 3)}
    if settings.stated is None:
        return truth
    truth |= {
        "resting_offset_mm": round(1000 * settings.resting_m(layout), 3),
        "stated_resting_offset_mm": round(1000 * settings.stated.offset_m, 3),
        "resting_sd_mm": round(1000 * settings.stated.sd_m, 3),
        "surface": settings.surface_of(layout).kind,
    }
    if settings.conditions is not None:
        truth["world"] = _world_row(settings.conditions)
    return truth


def _world_row(conditions: Conditions) -> dict[str, Any]:
    """The recording's own camera, belt and cultivar, in the units of `Conditions`."""
    row = {name: value for name, value in asdict(conditions).items() if name not in ("preset", "stock", "resting_m")}
    stock = conditions.stock
    return row | {
        "noise": asdict(conditions.preset.noise),
        "cultivar": None if stock is None else stock.cultivar,
        "season": None if stock is None else stock.season,
    }


def truth_path(out: Path) -> Path:
    """Where the truth of the recording `out` lies."""
    return out.with_suffix(".truth.json") if out.suffix == ".mcap" else out / "truth.json"


def as_text(values: dict[str, Any]) -> str:
    """JSON as it lies in recordings."""
    return json.dumps(values, indent=1) + "\n"


def write_folder(out: Path, sources: list[SimulatedSource], texts: dict[str, str], on_frame: OnFrame) -> None:
    """Every source's frames into a folder recording at `out`, and the `texts` by file name beside them."""
    total, done = _total(sources), 0
    out.mkdir(parents=True, exist_ok=True)
    for source in sources:
        with FolderWriter(out, source.description) as writer:
            for frame in source.frames(run="simulated"):
                if isinstance(frame, Frame):
                    writer.write(frame)
                done += 1
                on_frame(done, total)
    for name, text in texts.items():
        (out / name).write_text(text, encoding="utf-8")


def _write_mcap(out: Path, sources: list[SimulatedSource], texts: dict[str, str], on_frame: OnFrame) -> None:
    with McapFrameWriter(out) as writer:
        for source in sources:
            d = source.description
            writer.add_camera(d.name, fps=d.fps, resting_offset_mm=d.resting_offset_mm, resting_sd_mm=d.resting_sd_mm)
        _write_frames(writer, out, sources, texts, on_frame)


def _write_ros2(out: Path, sources: list[SimulatedSource], texts: dict[str, str], on_frame: OnFrame) -> None:
    from conveyor.formats.ros2.writer import Ros2McapWriter

    with Ros2McapWriter(out) as writer:
        for source in sources:
            writer.add_camera(source.description)
        _write_frames(writer, out, sources, texts, on_frame)


def _write_frames(
    writer: Any, out: Path, sources: list[SimulatedSource], texts: dict[str, str], on_frame: OnFrame
) -> None:
    for name, text in texts.items():
        writer.attach(name, text.encode())
    for done, frame in enumerate(in_time(sources, run="recorded"), start=1):
        if isinstance(frame, Frame):
            writer.write(frame)
        on_frame(done, _total(sources))
    truth_path(out).write_text(texts["truth.json"], encoding="utf-8")


def _total(sources: list[SimulatedSource]) -> int:
    return sum(source.description.frames or 0 for source in sources)
