"""`info` warns of a unit that cannot be though no distance is given, and says that a file is still being written."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest

from conveyor.errors import InputError
from conveyor.formats import open_source
from conveyor.formats.conversion import convert_recording
from conveyor.formats.folder.writer import FolderWriter
from conveyor.formats.inspection import inspect_recording
from conveyor.formats.mcap.recovery import recover
from conveyor.formats.mcap.writer import McapFrameWriter
from conveyor.formats.source import CameraDescription
from conveyor.geometry import Intrinsics
from conveyor.messages import Frame

K = Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0)


def frame(seq: int, scale_m: float = 0.001, belt: int = 460) -> Frame:
    """A bare belt."""
    depth = np.full((48, 64), belt, np.uint16)
    return Frame("front", "r", seq, seq * 33_000_000, None, scale_m, K, None, depth)


@pytest.mark.parametrize(
    ("belt", "scale_m", "words"),
    [
        (11570, 0.001, r"the belt seems 11\.57 m away.*a unit that fits is 0\.0001 \(1\.16 m\) and 5e-05 \(0\.579 m\)"),
        (460, 0.0001, r"the belt seems 0\.046 m away.*a unit that fits is 0\.001 \(0\.46 m\)"),
        (460, 0.001, "the belt distance is not given: it has to be fitted"),
    ],
)
def test_a_unit_that_cannot_be_is_told_without_a_given_distance(
    belt: int, scale_m: float, words: str, tmp_path: Path
) -> None:
    with FolderWriter(tmp_path / "r", CameraDescription("front", "t", K, scale_m, None, None, 30.0, 3)) as writer:
        for seq in range(3):
            writer.write(frame(seq, scale_m, belt))
    (camera,) = inspect_recording(tmp_path / "r").cameras
    assert len(camera.warnings) == 1
    import re

    assert re.search(words, camera.warnings[0])


def test_of_frames_that_cannot_be_read_nothing_is_said(tmp_path: Path) -> None:
    """They had no masks, and their belt distance was not given, beside the one that was."""
    with FolderWriter(tmp_path / "r", CameraDescription("front", "t", K, 0.001, 0.46, None, 30.0, 1)) as writer:
        writer.write(frame(0))
    (tmp_path / "r" / "front" / "depth" / "000000.png").write_bytes(b"")
    (camera,) = inspect_recording(tmp_path / "r").cameras
    assert (camera.belt_given_m, camera.travel, camera.masks, camera.color) == (0.46, None, None, None)
    broken, nothing = camera.warnings
    assert "000000.png is truncated or no PNG" in broken
    assert nothing == "none of the frames looked at can be read: a replay would count nothing"


def test_a_file_that_is_being_written_is_told_so(tmp_path: Path) -> None:
    path = tmp_path / "live.mcap"
    with McapFrameWriter(path) as writer:
        for seq in range(200):
            writer.write(frame(seq))
        writer.sync()
        with pytest.raises(InputError, match=r"live\.mcap is being written: .* MB, the last of them \d s ago"):
            inspect_recording(path)
        begun = path.read_bytes()
    assert inspect_recording(path).cameras[0].frames == 200
    killed = tmp_path / "killed.mcap"
    killed.write_bytes(begun)
    os.utime(killed, (time.time() - 60,) * 2)
    with pytest.raises(InputError, match=r"`tuberline recover .*killed\.mcap` saves what is whole") as told:
        inspect_recording(killed)
    assert "being written" not in str(told.value)
    recover(killed, tmp_path / "saved.mcap")


def test_a_recording_without_a_frame_is_refused_by_its_name(tmp_path: Path) -> None:
    """Of a recorder that was stopped before the first; `convert` made an empty file, or missed a folder."""
    path = tmp_path / "empty.mcap"
    with McapFrameWriter(path):
        pass
    for use in (
        inspect_recording,
        open_source,
        lambda path: convert_recording(path, tmp_path / "out.mcap"),
        lambda path: convert_recording(path, tmp_path / "out"),
    ):
        with pytest.raises(InputError, match=r"empty\.mcap holds no frames of any camera"):
            use(path)
    assert list(tmp_path.iterdir()) == [path]
