"""From one recording format to another, losing nothing: depth, masks, colour, times, travel, truth."""

from __future__ import annotations

import heapq
import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from camera_sim.sources import Refused, Source, camera_names, open_source
from camera_sim.sources.detect import recording_kind
from camera_sim.sources.folder_writer import FolderWriter, write_line_file
from camera_sim.sources.mcap_format import ATTACHMENTS
from conveyor.errors import InputError
from conveyor.messages import Frame


@dataclass(frozen=True, slots=True)
class Converted:
    """How many frames were written, and how many could not be read, by reason, with the first texts."""

    frames: int
    refused: dict[str, int]
    texts: tuple[str, ...]


def convert_recording(
    source: Path,
    target: Path,
    *,
    belt_distance_m: float | None = None,
    depth_scale_m: float | None = None,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Converted:
    """Write the recording at `source` as MCAP where `target` ends in .mcap, else as a folder.

    Frames keep their numbers, times, travel and bytes; colour in PNG files becomes JPEG, the only loss.

    Raises:
        InputError: `source` unusable, `target` there already, or a depth scale that contradicts the belt distance
            (give the right one).
    """
    if target.exists():
        raise InputError(f"{target} exists; recordings are not overwritten, choose another name")
    sources = [
        open_source(source, camera=name, belt_distance_m=belt_distance_m, depth_scale_m=depth_scale_m)
        for name in camera_names(source)
    ]
    total = sum(one.description.frames or 0 for one in sources)
    refused: Counter[str] = Counter()
    texts: list[str] = []
    done = 0
    with ExitStack() as stack:
        write = (
            _to_mcap(stack, source, target, sources) if target.suffix == ".mcap" else _to_folder(stack, target, sources)
        )
        for item in _in_time(sources):
            if isinstance(item, Refused):
                refused[item.reason] += 1
                texts.append(item.text)
            else:
                write(item)
                done += 1
            on_frame(done + refused.total(), total)
    if target.suffix != ".mcap":
        _write_files(source, target, [one.description.name for one in sources])
    return Converted(done, dict(refused), tuple(texts[:10]))


def _in_time(sources: list[Source]) -> Iterator[Frame | Refused]:
    """Frames of all cameras, merged by the newest capture time of each camera; each camera's own order is kept."""

    def timed(n: int, source: Source) -> Iterator[tuple[int, int, int, Frame | Refused]]:
        newest = 0
        for count, item in enumerate(source.frames(run="recorded")):
            newest = max(newest, item.captured_ns) if isinstance(item, Frame) else newest
            yield newest, n, count, item

    for _, _, _, item in heapq.merge(*(timed(n, source) for n, source in enumerate(sources)), key=lambda t: t[:3]):
        yield item


def _to_mcap(stack: ExitStack, source: Path, target: Path, sources: list[Source]) -> Callable[[Frame], None]:
    from camera_sim.sources.mcap_writer import McapFrameWriter

    writer = stack.enter_context(McapFrameWriter(target))
    for one in sources:
        writer.add_camera(one.description.name, fps=one.description.fps)
    for name, data in _files(source).items():
        writer.attach(name, data)
    return writer.write


def _to_folder(stack: ExitStack, target: Path, sources: list[Source]) -> Callable[[Frame], None]:
    writers = {one.description.name: stack.enter_context(FolderWriter(target, one.description)) for one in sources}
    return lambda frame: writers[frame.camera].write(frame)


def _files(source: Path) -> dict[str, bytes]:
    """truth.json and line.json, where the recording has them."""
    if recording_kind(source) == "mcap":
        from camera_sim.sources.mcap_source import mcap_attachments

        return mcap_attachments(source)
    return {name: (source / name).read_bytes() for name in ATTACHMENTS if (source / name).is_file()}


def _write_files(source: Path, target: Path, cameras: list[str]) -> None:
    files = _files(source)
    for name, data in files.items():
        (target / name).write_bytes(data)
    if "line.json" not in files:
        write_line_file(target, cameras, belt_speed_mps=None)
    else:
        known = json.loads(files["line.json"]).get("cameras", [])
        if sorted(known) != sorted(cameras):
            write_line_file(target, cameras, belt_speed_mps=None)
