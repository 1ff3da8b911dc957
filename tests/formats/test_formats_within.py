"""Nothing in a recording leads out of it: names that climb, links that leave, devices; every reader says so."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conveyor.errors import InputError
from conveyor.formats import camera_names, open_source
from conveyor.formats.conversion import convert_recording
from conveyor.formats.detect import describe_recording
from conveyor.formats.folder.writer import FolderWriter
from conveyor.formats.inspection import inspect_recording
from conveyor.formats.source import CameraDescription
from conveyor.formats.within import check_within, plain_name
from tests.belts import tuberline
from tests.viewer.viewer_line import BELT_DISTANCE_M, FPS, LENS, SCALE_M, frame, potatoes

READERS: dict[str, Callable[[Path], object]] = {
    "info": inspect_recording,
    "describe": describe_recording,
    "names": camera_names,
    "open": lambda path: open_source(path, camera="front"),
    "convert": lambda path: convert_recording(path, path.parent / "converted", form="folder"),
}
CLIMBING = ("../front", "..", ".", "", "/etc", "a/b", "a\\b", "a\0b", "a\nb", "\x1b[2Jfront", "x" * 300)


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A recording of camera 'front' with three frames, to be damaged."""
    path = tmp_path / "recording"
    tubers = potatoes(3, seed=4)
    described = CameraDescription(
        name="front",
        origin="a test",
        intrinsics=LENS,
        depth_scale_m=SCALE_M,
        belt_distance_m=BELT_DISTANCE_M,
        belt_from_camera=None,
        fps=FPS,
        frames=3,
    )
    with FolderWriter(path, described) as writer:
        for seq in range(3):
            writer.write(frame(seq, tubers))
    (path / "line.json").write_text('{"cameras": ["front"]}')
    inspect_recording(path)
    return path


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("name", ["../outside/front", "/etc", "..", "front/../../outside/front"])
def test_a_line_that_names_a_camera_elsewhere_is_refused(recorded: Path, reader: str, name: str) -> None:
    """`info` read what lay beside the recording."""
    outside = recorded.parent / "outside"
    shutil.copytree(recorded / "front", outside / "front")
    (recorded / "line.json").write_text(json.dumps({"cameras": [name]}))
    with pytest.raises(InputError, match=r"no plain name") as caught:
        READERS[reader](recorded)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("reader", ["info", "describe", "open", "convert"])
@pytest.mark.parametrize("name", CLIMBING)
def test_a_camera_file_that_names_itself_elsewhere_is_refused(recorded: Path, reader: str, name: str) -> None:
    """`convert` wrote to wherever camera.json said."""
    file = recorded / "front" / "camera.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "name": name}))
    before = sorted(recorded.parent.rglob("*"))
    with pytest.raises(InputError) as caught:
        READERS[reader](recorded)
    assert "\x1b" not in str(caught.value)
    assert sorted(recorded.parent.rglob("*")) == before


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("what", ["front", "front/depth", "front/depth/000001.png", "front/frames.csv", "truth.json"])
def test_a_link_that_leaves_the_recording_is_refused(recorded: Path, reader: str, what: str) -> None:
    inside, outside = recorded / what, recorded.parent / "elsewhere"
    if inside.exists():
        inside.rename(outside)
    else:
        outside.write_text("{}")
    inside.symlink_to(os.path.relpath(outside, inside.parent))
    with pytest.raises(InputError, match="link out of the recording") as caught:
        READERS[reader](recorded)
    assert str(inside) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_pipe_a_link_to_a_device_and_a_link_to_itself_are_refused(recorded: Path) -> None:
    odd = recorded / "front" / "mask"
    shutil.rmtree(odd, ignore_errors=True)
    os.mkfifo(odd)
    with pytest.raises(InputError, match="pipe"):
        inspect_recording(recorded)
    odd.unlink()
    odd.symlink_to("/dev/zero")
    with pytest.raises(InputError, match="link out of the recording"):
        inspect_recording(recorded)
    odd.unlink()
    odd.symlink_to(odd)
    with pytest.raises(InputError, match="link"):
        inspect_recording(recorded)


def test_links_within_and_a_link_to_the_whole_are_fine(recorded: Path, tmp_path: Path) -> None:
    kept = recorded / "kept"
    kept.mkdir()
    frames = recorded / "front" / "frames.csv"
    frames.rename(kept / "frames.csv")
    frames.symlink_to(kept / "frames.csv")
    link = tmp_path / "link"
    link.symlink_to(recorded)
    assert inspect_recording(link).cameras[0].name == "front"


def test_the_command_says_one_sentence(recorded: Path) -> None:
    (recorded / "line.json").write_text('{"cameras": ["../../etc"]}')
    done = tuberline("info", recorded, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("tuberline: ")
    assert "no plain name" in done.stderr


def test_a_folder_is_never_written_under_a_name_that_climbs(recorded: Path, tmp_path: Path) -> None:
    from dataclasses import replace

    description = describe_recording(recorded).cameras[0]
    with pytest.raises(InputError, match="no plain name"):
        FolderWriter(tmp_path / "out", replace(description, name="../../elsewhere"))


@given(name=st.text(max_size=40))
def test_a_name_that_is_taken_stays_below_its_folder(name: str) -> None:
    root = Path("/recordings/one")
    try:
        taken = plain_name(name, where="line.json")
    except InputError:
        return
    assert Path(os.path.normpath(root / taken)).parent == root


def test_a_recording_without_links_is_looked_through(recorded: Path) -> None:
    check_within(recorded)
