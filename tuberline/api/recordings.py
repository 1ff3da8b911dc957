"""Open any recording and read it frame by frame; simulate one with known truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from conveyor.errors import InputError
from conveyor.formats import CameraDescription, Refused, camera_names, describe_recording, open_source
from conveyor.formats.merged import in_time
from conveyor.messages import Frame
from conveyor.text_files import read_json
from tuberline.api.values import by_parameters, holds

SCENE_RANGES = {
    "seed": (0, 1e18),
    "tubers": (1, 100_000),
    "fps": (1, 120),
    "speed_mps": (0.01, 5),
    "belt_distance_m": (0.25, 1.5),
    "resting_offset_mm": (-20, 30),
    "heave_mm": (0, 30),
    "heave_hz": (0.1, 20),
}
WHOLE = ("seed", "tubers")


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording of one or several cameras over a belt.

    Attributes:
        path: where it lies.
        kind: 'folder', 'mcap', '3dpotatotwin', 'rosbag' or 'ros2-export'.
        cameras: each with name, intrinsics, depth_scale_m, belt_distance_m, belt_from_camera, fps and frames.
    """

    path: Path
    kind: str
    cameras: tuple[CameraDescription, ...]

    def frames(
        self, camera: str | None = None, *, on_refused: Callable[[Refused], None] | None = None
    ) -> Iterator[Frame]:
        """All frames in the order of time; of all cameras, or of one.

        A frame has camera, seq, captured_ns, travel_m, depth (H, W) uint16 in units of depth_scale_m metres,
        intrinsics, belt_distance_m or belt_from_camera, and where the recording has them mask (H, W) uint16 (instance
        labels, 0 = background) and color_jpeg.

        Args:
            camera: name of one camera; None reads all.
            on_refused: called with each frame that is there and cannot be read (seq, reason, text); None raises then.

        Raises:
            TuberlineError: no such camera, a depth scale that contradicts the belt distance, or a frame that cannot
                be read where nothing is given to call.
        """
        names = [camera] if camera is not None else list(camera_names(self.path))
        for item in in_time([open_source(self.path, camera=name) for name in names], run="read"):
            if isinstance(item, Frame):
                yield item
            elif on_refused is None:
                raise InputError(f"{self.path}: {item.text}")
            else:
                on_refused(item)

    def truth(self) -> dict[str, Any] | None:
        """The recording's truth.json (see docs/formats.md), or None where no one knows it. For evaluation only."""
        beside = self.path.with_suffix(".truth.json") if self.path.is_file() else self.path / "truth.json"
        if not beside.is_file():
            return None
        truth = read_json(beside, what="truth")
        if not isinstance(truth, dict):
            raise InputError(f"truth {beside} cannot be used: it must be a JSON object, got {type(truth).__name__}")
        return truth


def open_recording(path: str | Path) -> Recording:
    """Open a recording of any known format; reads no more than its first frames.

    Args:
        path: a folder recording, an .mcap file, a 3DPotatoTwin folder, or a ROS bag.

    Raises:
        TuberlineError: no recording of a known kind, or one that cannot be used; the text lists what was looked for.
    """
    found, names = describe_recording(Path(path)), camera_names(Path(path))
    cameras = tuple(open_source(found.path, camera=name).description for name in names)
    return Recording(found.path, found.kind, cameras)


@by_parameters
def simulate(
    out: str | Path,
    *,
    seed: int = 1,
    tubers: int = 60,
    scene: str = "touching",
    camera: Literal["d405-848", "d405-1280"] = "d405-848",
    preset: Literal["easy", "field", "harsh"] = "easy",
    fps: float = 30.0,
    speed_mps: float = 0.31,
    belt_distance_m: float = 0.46,
    masks: bool = False,
    color: bool = False,
) -> Recording:
    """Simulate a belt with known truth and record it.

    Args:
        out: a folder, or a file whose name ends in .mcap. Must not exist.
        seed: the same seed gives the same recording; a whole number from 0.
        tubers: how many ride on the belt, 1 to 100000.
        scene: 'singulated', 'touching', 'crowded', 'piled', 'distractors', 'two-cameras' and others, see `tuberline
            simulate --help`.
        camera: resolution of the camera.
        preset: tubers at rest under a good camera (easy), odd poses, a belt height that is not well known and a worse
            camera (field), or a camera, a belt and a cultivar drawn from all that real ones showed (harsh).
        fps: frames per second and camera, 1 to 120.
        speed_mps: of the belt, metres per second, 0.01 to 5.
        belt_distance_m: from the camera to the belt along the optical axis, metres, 0.25 to 1.5.
        masks: record instance masks too.
        color: record colour images too.

    Returns:
        The recording, opened.

    Raises:
        TuberlineError: `out` exists or cannot be written, a scene, camera or preset that there is not, or a value out
            of range.
    """
    from camera_sim.sim.optics import optics_named
    from camera_sim.sim.presets import PRESETS
    from camera_sim.sim.record import record_scene
    from camera_sim.sim.scenes import SceneSettings
    from conveyor.files import whole_output
    from conveyor.formats.beside import check_new

    target = Path(out)
    check_new(target)
    if preset not in PRESETS:
        raise InputError(f"preset '{preset}' is unknown; known: {', '.join(PRESETS)}")
    check_ranges(seed=seed, tubers=tubers, fps=fps, speed_mps=speed_mps, belt_distance_m=belt_distance_m)
    settings = SceneSettings(
        scene=scene,
        seed=int(seed),
        tubers=int(tubers),
        preset=PRESETS[preset],
        optics=optics_named(camera),
        fps=fps,
        speed_mps=speed_mps,
        belt_distance_m=belt_distance_m,
    )
    with whole_output(target) as partial:
        record_scene(partial, settings, masks=masks, color=color)
    return open_recording(target)


def check_ranges(**values: float) -> None:
    """Refuse settings of a scene that are out of range, by name.

    Raises:
        InputError: with the name, the value and what is allowed.
    """
    for name, value in values.items():
        low, high = SCENE_RANGES[name]
        if not holds(value, (low, high), whole=name in WHOLE):
            kind = ", a whole number" if name in WHOLE else ""
            raise InputError(f"{name} {value}: allowed is {low:g} to {high:g}{kind}")
