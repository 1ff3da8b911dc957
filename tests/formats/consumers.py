"""Everything that reads recordings, and small recordings of every format to read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from camera_sim.configured import configured_source
from conveyor.config import CameraConfig, LineConfig
from conveyor.errors import InputError
from conveyor.formats import CameraDescription, camera_names
from conveyor.formats.conversion import convert_recording
from conveyor.formats.folder.writer import FolderWriter
from conveyor.formats.inspection import inspect_recording
from conveyor.formats.mcap.writer import McapFrameWriter
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages import Frame
from segmenter.calibrate import calibrate_recording
from segmenter.pipeline import Settings
from segmenter.studies.evaluate import evaluate_recording
from segmenter.studies.offline import segment_recording
from tests.segmenter.segmenter_scene import SMALL, Body, Scene

BELT_M = 0.46
STEP_M = 0.02
FRAMES = 24
BODIES = [Body(-0.15, -0.05), Body(-0.28, 0.05)]
"""Both cross the centre row within FRAMES steps."""


def replayed(recording: Path) -> list[Any]:
    """All frames of all cameras, as the camera process of a replayed line gets them."""
    config = LineConfig(cameras={name: CameraConfig(path=recording) for name in camera_names(recording)})
    return [item for name in config.cameras for item in configured_source(config, name).frames(run="test")]


CONSUMERS: dict[str, Callable[[Path], Any]] = {
    "info": inspect_recording,
    "replay": replayed,
    "calibrate belt": calibrate_recording,
    "segment": segment_recording,
    "evaluate-segmentation": lambda path: evaluate_recording(path, settings=Settings()),
}


def consumed(recording: Path) -> dict[str, Any]:
    """What every consumer makes of a recording."""
    return {name: consumer(recording) for name, consumer in CONSUMERS.items()}


def refusals(recording: Path, *, but: tuple[str, ...] = ()) -> dict[str, str]:
    """What every consumer says on refusing a recording; fails where one takes it."""
    said = {}
    for name, consumer in CONSUMERS.items():
        if name not in but:
            with pytest.raises(InputError) as error:
                consumer(recording)
            said[name] = str(error.value)
    return said


def description(**changes: Any) -> CameraDescription:
    """The camera of these recordings."""
    d = CameraDescription("front", "a test", SMALL, 0.001, BELT_M, None, 30.0, FRAMES)
    return replace(d, **changes)


def frames(*, belt_from_camera: NDArray[np.float64] | None = None) -> list[Frame]:
    """Two tubers riding through, with masks and travel; `belt_from_camera` is written, and not rendered."""
    scene = Scene(BODIES, noise_m=0.0005, seed=5)
    made = []
    for seq in range(FRAMES):
        depth, labels = scene.render(seq * STEP_M, seq)
        made.append(
            Frame(
                camera="front",
                run="made",
                seq=seq,
                captured_ns=10**9 + seq * 33_333_333,
                travel_m=seq * STEP_M,
                depth_scale_m=0.001,
                intrinsics=SMALL,
                belt_distance_m=BELT_M,
                depth=depth,
                mask=labels,
                belt_from_camera=belt_from_camera,
            )
        )
    return made


def write_folder(root: Path, *, made: list[Frame] | None = None, **changes: Any) -> Path:
    """A folder recording of one camera."""
    with FolderWriter(root, description(**changes)) as writer:
        for frame in made or frames():
            writer.write(frame)
    return root


def write_mcap(path: Path, made: list[Frame]) -> Path:
    """An MCAP recording of one camera."""
    with McapFrameWriter(path) as writer:
        for frame in made:
            writer.write(frame)
    return path


def write_bag(source: Path, path: Path) -> Path:
    """A ROS 2 bag as somebody else records it: depth and camera info, and nothing of ours beside them."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    export = path.with_suffix(".export.mcap")
    convert_recording(source, export, form="ros2")
    channels: dict[int, int] = {}
    with export.open("rb") as old, path.open("wb") as new:
        writer = Writer(new)
        writer.start(profile="ros2")
        for schema, channel, message in make_reader(old).iter_messages():
            if "/depth/" in channel.topic and schema is not None:
                if channel.id not in channels:
                    number = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.id] = writer.register_channel(channel.topic, "cdr", number)
                writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    return path


def add_byte_order_mark(path: Path) -> None:
    """As a spreadsheet or an editor saves it."""
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())


def not_rigid() -> NDArray[np.float64]:
    """A pose whose rotation stretches."""
    pose = straight_down_belt_from_camera(BELT_M)
    pose[0] *= 1.1
    return pose
