"""`tuberline init`: the file of a new line, from what is found here."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from conveyor.errors import InputError
from conveyor.processors import usable
from conveyor.stated import BELT_DISTANCE_M
from tuberline.cli.address import endpoint
from tuberline.cli.numbers import BeltDistance, within

if TYPE_CHECKING:
    from tuberline.setup.found import Found


def init(
    file: Path = Path("line.toml"),
    /,
    *,
    name: str | None = None,
    recording: tuple[Path, ...] = (),
    realsense: bool = False,
    ros_router: str | None = None,
    ros_domain: Annotated[int, within(0, 232)] | None = None,
    belt_distance_m: BeltDistance | None = None,
) -> None:
    """Write a line's file, with remarks, for what it finds: RealSense cameras, recordings, ROS 2 depth topics.

    Without a choice it looks for connected cameras and for recordings in this folder; in a terminal it asks which.

    Parameters
    ----------
    file
        What to write; must not exist.
    name
        Of the line; default: the file's name.
    recording
        A recording to play as if it were a camera; may be given several times.
    realsense
        All RealSense cameras that are connected, and nothing else.
    ros_router
        Endpoint of a ROS 2 system's rmw_zenohd, e.g. tcp/10.0.0.7:7447: its depth topics.
    ros_domain
        Its ROS_DOMAIN_ID; default: 0.
    belt_distance_m
        Camera to belt along the optical axis, metres.
    """
    from conveyor.config import load_config
    from conveyor.files import whole_output
    from conveyor.topics import check_name
    from tuberline.setup.found import common_belt, found_recording, found_ros2, named
    from tuberline.setup.line_file import line_file

    if file.exists():
        raise InputError(f"{file} exists; choose another name, or remove it first")
    if file.suffix != ".toml":
        raise InputError(f"{file}: the name of a line's file ends in .toml")
    given = {"--recording": bool(recording), "--realsense": realsense, "--ros-router": ros_router is not None}
    if sum(given.values()) > 1:
        raise InputError(f"{' and '.join(option for option in given if given[option])}: give one of them")
    if ros_domain is not None and ros_router is None:
        raise InputError(f"--ros-domain {ros_domain} is of a ROS 2 system: name its router with --ros-router")
    line = check_name(name or file.stem, what="line")
    chosen: list[Found]
    if recording:
        chosen = [found_recording(path) for path in recording]
    elif ros_router is not None:
        chosen = _choose(
            found_ros2(endpoint(ros_router), ros_domain or 0), f"no depth topic is published through {ros_router}"
        )
    else:
        chosen = _choose(*_look(realsense))
    known = all(one.distance_known for one in chosen)
    distance_m = belt_distance_m if belt_distance_m is not None or known else _ask_distance()
    cameras = named(chosen)
    if distance_m is not None:
        cameras = {camera: {**settings, "belt_distance_m": distance_m} for camera, settings in cameras.items()}
    processes = min(8, max(1, usable() - len(cameras)))
    belt = common_belt(chosen)
    text = line_file(line, cameras, file=file, distance_known=known, processes=processes, belt=belt)
    with whole_output(file) as partial:
        partial.write_text(text, encoding="utf-8")
        load_config(partial)
    sys.stdout.write(f"{file}: line '{line}', camera {', '.join(cameras)}\n")
    sys.stdout.write(f"run it: tuberline run {file}\n")
    sys.stdout.write(f"in another terminal: tuberline doctor --config {file}, tuberline top --config {file}\n")
    if not belt and any(one.belt for one in chosen):
        sys.stdout.write("the recordings state several resting levels: give the line's own in its section [belt]\n")
    if distance_m is None and not known:
        sys.stdout.write("the belt distance is not given: it is fitted to what is seen; better measure it\n")


def _look(realsense_only: bool) -> tuple[list[Found], str]:
    """What is here, and what to say where nothing is."""
    from tuberline.setup.found import found_realsense, found_recordings

    devices, fault = found_realsense()
    if realsense_only:
        return devices, fault or "no RealSense camera is connected: check the cable and the udev rules"
    return [*devices, *found_recordings(Path())], (
        "no RealSense camera and no recording is found here; name one with --recording PATH or --ros-router "
        "tcp/HOST:7447, or make one: tuberline simulate --out recordings/one" + (f" ({fault})" if fault else "")
    )


def _choose(found: list[Found], where_none: str) -> list[Found]:
    """All cameras of one kind that is live, or the one that is chosen."""
    if not found:
        raise InputError(where_none)
    if len(found) == 1:
        return found
    listed = "\n".join(f"  {number}  {one.words}" for number, one in enumerate(found, start=1))
    if not sys.stdin.isatty():
        raise InputError(
            f"found {len(found)} sources; choose with --recording or --realsense, or in a terminal:\n{listed}"
        )
    sys.stderr.write(f"found:\n{listed}\n")
    while True:
        words = _ask("which? numbers with blanks between them [1]: ").split() or ["1"]
        if all(word.isdecimal() and 1 <= int(word) <= len(found) for word in words):
            return [found[int(word) - 1] for word in dict.fromkeys(words)]
        sys.stderr.write(f"numbers from 1 to {len(found)}\n")


def _ask_distance() -> float | None:
    if not sys.stdin.isatty():
        return None
    low_m, high_m = BELT_DISTANCE_M
    while True:
        text = _ask("camera to belt along the optical axis, metres [fit it to what is seen]: ")
        if not text:
            return None
        try:
            distance_m = float(text)
        except ValueError:
            distance_m = 0.0
        if low_m <= distance_m <= high_m:
            return distance_m
        sys.stderr.write(f"a number from {low_m:g} to {high_m:g}, e.g. 0.46\n")


def _ask(question: str) -> str:
    sys.stderr.write(question)
    sys.stderr.flush()
    line = sys.stdin.readline()
    if not line:
        raise InputError("stopped: no answer; nothing was written")
    return line.strip()
