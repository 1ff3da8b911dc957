"""The belts of the simulated day: rendered, segmented, tracked and weighed by the line's own code, kept load by load.

A load's belt is a stretch of its own. Every frame of both cameras is rendered and goes through `CameraRun`, the core of
a segmenter, which asks a `Weigher`, the core of a regressor. What comes out, the entries of each camera's log, is kept.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import msgpack

from benchmarks.day_world import CAMERAS, GAPS, DayPlan, LoadPlan, belt_settings
from camera_sim.sim.scenes import build_world
from camera_sim.sim.source import SimulatedSource, simulated_sources, truth_of
from conveyor.config import LineConfig, parse_config
from conveyor.files import whole_output
from conveyor.messages import Frame, TrackEntry
from regressor.weigh.weigher import Weigher, weigh_views
from segmenter.camera_run import CameraRun
from segmenter.setup import run_settings
from segmenter.warmup import warm_up

RUN = "day"
WORKER = "inline"


@dataclass(frozen=True, slots=True)
class Belt:
    """One load's belt as kept.

    Attributes:
        logs: by camera, the entries of its log, from 1 to its final mark; times and travel from the belt's own start.
        frames: by camera, (capture ns, travel m) of each frame that was rendered; those in a gap are among them.
        truth: as truth.json has it.
    """

    logs: dict[str, list[TrackEntry]]
    frames: dict[str, list[tuple[int, float]]]
    truth: dict[str, Any]


def line_config(folder: Path | None = None, **aggregator: Any) -> LineConfig:
    """The config of the day's line."""
    values = {
        "name": "plots",
        "cameras": {name: {"path": "x"} for name in CAMERAS},
        "aggregator": {**({"out": str(folder)} if folder else {}), **aggregator},
        "gnss": {"source": "file:track.nmea", "width_m": 0.75},
    }
    return parse_config(values, where="simulated day")


def make_belts(plan: DayPlan, folder: Path, *, workers: int) -> None:
    """Make the belts that are not in `folder` yet, `workers` at a time."""
    folder.mkdir(parents=True, exist_ok=True)
    missing = [load for load in plan.loads if not belt_file(folder, load, plan.seed).is_file()]
    if workers <= 1 or len(missing) <= 1:
        for load in missing:
            keep_belt(load, plan.seed, folder)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        list(pool.map(keep_belt, missing, [plan.seed] * len(missing), [folder] * len(missing)))


def belt_file(folder: Path, load: LoadPlan, seed: int) -> Path:
    """Where a load's belt is kept, named by all that it depends on."""
    return folder / f"belt-{seed}-{load.number:02d}-{load.stock.cultivar}-{load.tubers}.msgpack"


def keep_belt(load: LoadPlan, seed: int, folder: Path) -> None:
    """Make one belt and keep it, whole or not at all."""
    belt = make_belt(load, seed)
    packed = {
        "logs": {name: [entry.encode() for entry in log] for name, log in belt.logs.items()},
        "frames": belt.frames,
        "truth": json.dumps(belt.truth),
    }
    with whole_output(belt_file(folder, load, seed)) as path:
        path.write_bytes(msgpack.packb(packed))
    sys.stderr.write(f"belt {load.number}: {load.tubers} tubers, process {os.getpid()}\n")


def read_belt(folder: Path, load: LoadPlan, seed: int) -> Belt:
    """A belt that was kept."""
    packed = msgpack.unpackb(belt_file(folder, load, seed).read_bytes())
    return Belt(
        {name: [TrackEntry.decode(entry) for entry in log] for name, log in packed["logs"].items()},
        {name: [(at_ns, travel_m) for at_ns, travel_m in rows] for name, rows in packed["frames"].items()},
        json.loads(packed["truth"]),
    )


def make_belt(load: LoadPlan, seed: int) -> Belt:
    """Render, segment, track and weigh one load's belt."""
    config = line_config()
    warm_up(config.segmenter.pixel_mm)
    settings, layout = belt_settings(load, seed)
    world = build_world(settings, layout)
    sources = simulated_sources(world, settings, layout)
    weigher = Weigher.load(None)
    logs, frames = {}, {}
    for source in sources:
        name = source.description.name
        seen: list[tuple[int, float]] = []
        logs[name] = list(_log(source, load, config, weigher, seen))
        frames[name] = seen
    return Belt(logs, frames, truth_of(world, sources))


def _log(
    source: SimulatedSource, load: LoadPlan, config: LineConfig, weigher: Weigher, seen: list[tuple[int, float]]
) -> Iterator[TrackEntry]:
    """One camera's log over the belt; `seen` is filled with when its frames were taken, and where the belt was."""
    name = source.description.name
    camera = CameraRun(name, RUN, run_settings(config, name), None)
    away, from_share, to_share = GAPS.get(load.number, ((), 0.0, 0.0))
    count = source.description.frames or 0
    for frame in source.frames(run=RUN):
        if not isinstance(frame, Frame):
            continue
        seen.append((frame.captured_ns, frame.travel_m or 0.0))
        if name in away and from_share * count <= frame.seq < to_share * count:
            continue
        camera.frame(frame, 0.0)
        yield from _served(camera, weigher)
    camera.end(0.0)
    yield from _served(camera, weigher)


def _served(camera: CameraRun, weigher: Weigher) -> Iterator[TrackEntry]:
    """Weigh what is to be weighed, then hand on what the log holds."""
    while views := camera.tick(0.0, {WORKER}):
        for answer in weigh_views(weigher, [view for _, view in views], regressor=WORKER):
            camera.weight(answer)
    camera.tick(0.0, {WORKER})
    for entry in camera.log.due(0.0):
        yield entry
        camera.log.commit(entry.n)
