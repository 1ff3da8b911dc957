"""Which kind of recording a path is, and its cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from conveyor.errors import InputError
from conveyor.formats.potatotwin.layout import has_images
from conveyor.formats.source import CameraDescription, RecordedSource
from conveyor.formats.within import check_within, plain_name
from conveyor.text_files import read_json

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from conveyor.camera_place import CameraPlace
    from conveyor.formats.prepared import PreparedSource

Kind = Literal["folder", "mcap", "3dpotatotwin", "rosbag", "ros2-export"]
LOOKED_FOR = (
    "a folder recording (<camera>/camera.json and frames.csv, or such a camera folder itself)",
    "an MCAP recording (*.mcap)",
    "a 3DPotatoTwin folder (1_rgbd/1_image)",
    "a ROS bag (*.bag, *.db3, *.mcap of ROS or Foxglove, or a bag's folder with metadata.yaml)",
)


@dataclass(frozen=True, slots=True)
class Recording:
    """What a path holds: its kind and its cameras, in the recording's own order."""

    path: Path
    kind: Kind
    cameras: tuple[CameraDescription, ...]


def describe_recording(path: Path) -> Recording:
    """Look at every camera of the recording at `path`; reads no more than the first frames.

    Raises:
        InputError: no recording of a known kind, or one that cannot be used; the text lists what was looked for.
    """
    kind = recording_kind(path)
    return Recording(path, kind, tuple(open_unchecked(path, kind, name).description for name in camera_names(path)))


def camera_names(path: Path) -> tuple[str, ...]:
    """The cameras of the recording at `path`, in its own order.

    Raises:
        InputError: no recording, one without a frame of any camera, or a camera's name that is no plain one.
    """
    names = _camera_names(path, recording_kind(path))
    if not names:
        raise InputError(f"{path} holds no frames of any camera")
    return tuple(plain_name(name, where=path) for name in names)


def _camera_names(path: Path, kind: Kind) -> tuple[str, ...]:
    if kind == "folder":
        return tuple(_folders(path))
    if kind == "mcap":
        from conveyor.formats.mcap.reader import mcap_channels

        return tuple(channel.camera for channel in mcap_channels(path) if channel.messages)
    if kind == "rosbag":
        from conveyor.formats.rosbag.reader import bag_cameras

        return bag_cameras(path)
    if kind == "ros2-export":
        from conveyor.formats.ros2.reader import cameras_with_frames

        return tuple(cameras_with_frames(path))
    from conveyor.formats.potatotwin.reader import twin_cameras

    return twin_cameras(path)


def open_source(
    path: Path,
    *,
    camera: str | None = None,
    name: str | None = None,
    belt_distance_m: float | None = None,
    place: CameraPlace | None = None,
    belt_from_camera: NDArray[np.float64] | None = None,
    depth_scale_m: float | None = None,
    ignore_masks: bool = False,
    part: int | None = None,
) -> PreparedSource:
    """The frames of one camera of a recording, its depth scale checked against its belt distance.

    Args:
        camera: which one; may be left out where there is only one. Of a ROS bag also a depth topic ('/...').
        name: what the line calls it; default: the recording's own name.
        belt_distance_m, place, belt_from_camera, depth_scale_m: instead of what the recording says; a place leaves
            height and tilt as they are.
        ignore_masks: leave out the recording's own masks.
        part: which run of an MCAP file that holds several, from 1 on.

    Raises:
        InputError: no recording of a known kind, no such camera, or one that cannot be used.
    """
    from conveyor.formats.prepared import PreparedSource

    kind = recording_kind(path)
    by_topic = kind == "rosbag" and camera is not None and camera.startswith("/")
    chosen = camera if by_topic and camera else choose_camera(path, camera_names(path), camera)
    inner = open_unchecked(path, kind, chosen, part=part, masks=not ignore_masks)
    return PreparedSource(
        inner,
        where=str(path),
        name=name,
        belt_distance_m=belt_distance_m,
        place=place,
        belt_from_camera=belt_from_camera,
        depth_scale_m=depth_scale_m,
        ignore_masks=ignore_masks,
    )


def recording_kind(path: Path) -> Kind:
    """Which kind of recording is at `path`."""
    if not path.exists():
        raise InputError(f"{path} does not exist")
    if path.is_file():
        if path.suffix in (".bag", ".db3"):
            return "rosbag"
        with path.open("rb") as file:
            if path.suffix == ".mcap" or file.read(5) == b"\x89MCAP":
                return _mcap_kind(path)
    elif (kind := _folder_kind(path)) is not None:
        check_within(path)
        return kind
    raise InputError(f"{path} is no recording Tuberline knows; looked for: " + "; ".join(LOOKED_FOR))


def _folder_kind(path: Path) -> Kind | None:
    if has_images(path):
        return "3dpotatotwin"
    if (path / "metadata.yaml").is_file():
        return "rosbag"
    return "folder" if _folders(path) else None


def _mcap_kind(path: Path) -> Kind:
    """Ours where it has a channel of ours; a bag where it has others."""
    from conveyor.formats.mcap.reader import foreign_channels, mcap_channels
    from conveyor.formats.ros2.reader import exported_cameras

    if mcap_channels(path) or not foreign_channels(path):
        return "mcap"
    return "ros2-export" if exported_cameras(path) else "rosbag"


def choose_camera(path: Path, known: Sequence[str], camera: str | None) -> str:
    """Which of the cameras `known` of the recording at `path` is meant: the one of that name, or the only one.

    Raises:
        InputError: there is no such one, or several and none is named.
    """
    if camera is None and len(known) == 1:
        return known[0]
    if camera is None:
        raise InputError(f"{path} has several cameras: name one of {', '.join(known)}")
    if camera not in known:
        raise InputError(f"{path} has no camera '{camera}'; known: {', '.join(known)}")
    return camera


def open_unchecked(
    path: Path, kind: Kind, camera: str, *, part: int | None = None, masks: bool = True
) -> RecordedSource:
    """The source as it is recorded: for those who look for faults. Without `masks` a folder's are not even read.

    Raises:
        InputError: it cannot be opened, has no parts, or calls its camera what is no plain name.
    """
    if part is not None and kind != "mcap":
        raise InputError(f"{path} has no parts: only MCAP recordings of Tuberline's can hold several runs")
    source = _open(path, kind, camera, part, masks)
    plain_name(source.description.name, where=path)
    return source


def _open(path: Path, kind: Kind, camera: str, part: int | None, masks: bool) -> RecordedSource:
    if kind == "folder":
        from conveyor.formats.folder.reader import FolderSource

        return FolderSource(_folders(path)[camera], masks=masks)
    if kind == "mcap":
        from conveyor.formats.mcap.reader import McapSource

        return McapSource(path, camera, part=part)
    if kind == "rosbag":
        from conveyor.formats.rosbag.reader import RosBagSource

        return RosBagSource(path, camera)
    if kind == "ros2-export":
        from conveyor.formats.ros2.reader import Ros2ExportSource

        return Ros2ExportSource(path, camera)
    from conveyor.formats.potatotwin.reader import PotatoTwinSource

    return PotatoTwinSource(path, camera)


def _folders(path: Path) -> dict[str, Path]:
    """Camera folders by camera name."""
    if (path / "camera.json").is_file():
        return {path.resolve().name: path}
    line = path / "line.json"
    if not line.is_file():
        return {folder.parent.name: folder.parent for folder in sorted(path.glob("*/camera.json"))}
    names = _named_in(line)
    for name in names:
        plain_name(name, where=line)
        if not (path / name / "camera.json").is_file():
            raise InputError(f"{line} names camera '{name}', but {path / name / 'camera.json'} does not exist")
    return {name: path / name for name in names}


def unnamed_cameras(path: Path) -> list[str]:
    """For people: which camera folders of the recording at `path` are left out, for its line.json names others."""
    line = path / "line.json"
    if not line.is_file() or (path / "camera.json").is_file() or _folder_kind(path) != "folder":
        return []
    named = _named_in(line)
    there = [folder.parent.name for folder in sorted(path.glob("*/camera.json"))]
    out = ", ".join(f"'{name}'" for name in there if name not in named)
    told = f"{line} names {', '.join(named)} alone, so {out} beside it is left out"
    fix = 'name it in "cameras" there too, or remove line.json: all folders with a camera.json are taken then'
    return [f"{told}; {fix}"] if out else []


def _named_in(line: Path) -> list[str]:
    """The cameras that a line.json names."""
    raw = read_json(line)
    names = raw.get("cameras") if isinstance(raw, dict) else None
    if not isinstance(names, list) or not names or not _texts_apart(names):
        given = names if isinstance(raw, dict) else raw
        raise InputError(
            f'{line} must read {{"cameras": ["<name>", ...], ...}}, none twice, with the name of each camera\'s '
            f"folder, got {str(given)[:200]!a}; correct it, or remove it: all folders with a camera.json are taken then"
        )
    return names


def _texts_apart(names: list[Any]) -> bool:
    return all(isinstance(name, str) for name in names) and len(set(names)) == len(names)
