"""From one recording format to another, losing nothing: depth, masks, colour, times, travel, truth."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from conveyor.formats import Refused, Source, open_source
from conveyor.formats.beside import check_new, recording_files
from conveyor.formats.cameras import line_names, none_readable
from conveyor.formats.folder.writer import FolderWriter, write_line_file
from conveyor.formats.merged import in_time
from conveyor.formats.source import within_ranges
from conveyor.formats.target import TargetFormat, target_format
from conveyor.messages import Frame

Files = Mapping[str, bytes]


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
    form: TargetFormat = "auto",
    belt_distance_m: float | None = None,
    depth_scale_m: float | None = None,
    part: int | None = None,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Converted:
    """Write the recording at `source` to `target` in the format `form`; 'auto' goes by the name of `target`.

    Frames keep their numbers, times, travel and bytes; colour in PNG files becomes JPEG, the only loss.

    Args:
        part: which run of an MCAP file that holds several, from 1 on.

    Raises:
        InputError: `source` unusable, none of its frames readable, a camera that no line can call so, `target` there
            already, or a depth scale that contradicts the belt distance (give the right one).
    """
    check_new(target)
    sources: list[Source] = [
        open_source(source, camera=name, belt_distance_m=belt_distance_m, depth_scale_m=depth_scale_m, part=part)
        for name in line_names(source)
    ]
    return write_recording(sources, target, files=recording_files(source), form=form, on_frame=on_frame)


def write_recording(
    sources: Sequence[Source],
    target: Path,
    *,
    files: Files,
    form: TargetFormat = "auto",
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Converted:
    """Write the frames of all `sources`, one per camera, to `target`; `files` are those beside them (truth.json).

    Raises:
        InputError: a source that cannot be used, frames of which none can be read, or a place that cannot be written.
    """
    total = sum(one.description.frames or 0 for one in sources)
    refused: Counter[str] = Counter()
    texts: list[str] = []
    written: Counter[str] = Counter()
    chosen = target_format(target, form)
    with ExitStack() as stack:
        write = _WRITERS[chosen](stack, target, sources, files)
        for item in map(within_ranges, in_time(sources, run="recorded")):
            if isinstance(item, Refused):
                refused[item.reason] += 1
                texts.append(item.text)
            else:
                write(item)
                written[item.camera] += 1
            on_frame(written.total() + refused.total(), total)
    if refused and not written:
        raise none_readable(sources[0].description.origin, texts[0])
    if chosen == "folder":
        names = [one.description.name for one in sources]
        _write_files(target, files, [name for name in names if written[name]] or names)
    return Converted(written.total(), dict(refused), tuple(texts[:10]))


def _to_mcap(stack: ExitStack, target: Path, sources: Sequence[Source], files: Files) -> Callable[[Frame], None]:
    from conveyor.formats.mcap.writer import McapFrameWriter

    writer = stack.enter_context(McapFrameWriter(target))
    for one in sources:
        d = one.description
        writer.add_camera(d.name, fps=d.fps, resting_offset_mm=d.resting_offset_mm, resting_sd_mm=d.resting_sd_mm)
    for name, data in files.items():
        writer.attach(name, data)
    return writer.write


def _to_ros2(stack: ExitStack, target: Path, sources: Sequence[Source], files: Files) -> Callable[[Frame], None]:
    from conveyor.formats.ros2.writer import Ros2McapWriter

    writer = stack.enter_context(Ros2McapWriter(target))
    for one in sources:
        writer.add_camera(one.description)
    for name, data in files.items():
        writer.attach(name, data)
    return writer.write


def _to_folder(stack: ExitStack, target: Path, sources: Sequence[Source], files: Files) -> Callable[[Frame], None]:
    writers = {one.description.name: stack.enter_context(FolderWriter(target, one.description)) for one in sources}
    return lambda frame: writers[frame.camera].write(frame)


_WRITERS = {"folder": _to_folder, "mcap": _to_mcap, "ros2": _to_ros2}


def _write_files(target: Path, files: Files, cameras: list[str]) -> None:
    for name, data in files.items():
        (target / name).write_bytes(data)
    if _named_in(files.get("line.json", b"")) != set(cameras):
        write_line_file(target, cameras, belt_speed_mps=None)


def _named_in(line: bytes) -> set[str] | None:
    """The cameras that a line.json names; None of what is none: one that came in an attachment was never read."""
    try:
        named = json.loads(line)["cameras"]
        return set(named) if len(named) == len(set(named)) else None
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
