"""Frames on a link, raw and zstd: bytes, Mbit/s, and CPU to pack and to unpack one."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from pathlib import Path

from benchmarks.options import parser_of
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings
from conveyor.formats.detect import camera_names, open_source
from conveyor.messages import Frame

CODECS = ("raw", "zstd")
FRAMES = 20
FPS = 30


def main(arguments: list[str]) -> None:
    """Print the table for one camera of a recording, or for simulated ones without it."""
    parser = parser_of("site_codecs", __doc__)
    parser.add_argument("recording", type=Path, nargs="?", help="default: simulated at both depth units")
    options = parser.parse_args(arguments)
    rows: list[tuple[str, ...]] = []
    if options.recording:
        rows += codec_rows(options.recording.name, first_frames(options.recording))
    else:
        with tempfile.TemporaryDirectory(prefix="tuberline-codecs-") as folder:
            for unit_mm in (1.0, 0.1):
                path = Path(folder) / f"{unit_mm}"
                settings = SceneSettings("touching", 1, 6, PRESETS["field"], unit_m=unit_mm / 1000)
                record_scene(path, settings)
                rows += codec_rows(f"simulated, unit {unit_mm:g} mm", first_frames(path))
    head = ("frames", "codec", "kB a frame", f"Mbit/s at {FPS}/s", "pack, CPU ms", "unpack, CPU ms")
    sys.stdout.writelines(f"| {' | '.join(row)} |\n" for row in (head, ("---",) * len(head), *rows))


def first_frames(recording: Path) -> list[Frame]:
    """The first usable frames of the recording's first camera."""
    source = open_source(recording, camera=camera_names(recording)[0])
    return list(islice((f for f in source.frames(run="bench") if isinstance(f, Frame)), FRAMES))


def codec_rows(name: str, frames: Sequence[Frame]) -> list[tuple[str, ...]]:
    """One row a codec; times are the least of three passes, so that other work on the machine matters little."""
    rows: list[tuple[str, ...]] = []
    for codec in CODECS:
        packed = [frame.encode(codec=codec) for frame in frames]
        size = sum(map(len, packed)) / len(packed)
        pack_ms = _cpu_ms([partial(frame.encode, codec=codec) for frame in frames])
        unpack_ms = _cpu_ms([partial(Frame.decode, data) for data in packed])
        where = f"{name}, {frames[0].depth.shape[1]}x{frames[0].depth.shape[0]}"
        rows.append(
            (where, codec, f"{size / 1e3:.0f}", f"{8 * size * FPS / 1e6:.0f}", f"{pack_ms:.2f}", f"{unpack_ms:.2f}")
        )
    return rows


def _cpu_ms(calls: Sequence[Callable[[], object]]) -> float:
    """CPU milliseconds of one call."""
    best_s = float("inf")
    for _ in range(3):
        started_s = time.process_time()
        for call in calls:
            call()
        best_s = min(best_s, (time.process_time() - started_s) / len(calls))
    return 1e3 * best_s
