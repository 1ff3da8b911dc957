"""`tuberline simulate`: a recording of a belt with known truth."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from conveyor.errors import InputError
from tuberline.cli.simulate_views import remove

TargetFormat = Literal["auto", "folder", "mcap", "ros2"]


def simulate(
    *,
    out: Path,
    seed: int = 1,
    tubers: int = 60,
    scene: str = "touching",
    camera: Literal["d405-848", "d405-1280"] = "d405-848",
    fps: float = 30.0,
    speed_mps: float = 0.31,
    belt_distance_m: float = 0.46,
    preset: Literal["easy", "field", "harsh", "matched"] = "easy",
    resting_offset_mm: float = 0.0,
    heave_mm: float = 0.0,
    heave_hz: float = 4.0,
    depth_unit_mm: Literal["1", "0.1"] = "1",
    travel: Annotated[bool, Parameter(negative="--no-travel")] = True,
    masks: bool = False,
    color: bool = False,
    inject: tuple[str, ...] = (),
    format: TargetFormat = "auto",
    force: bool = False,
    json: bool = False,
) -> None:
    """Make a recording of a belt with known truth: a folder with truth.json, or an MCAP file with its truth beside it.

    Parameters
    ----------
    out
        What to write: a folder, or a name ending in .mcap.
    seed
        The same seed gives the same recording.
    tubers
        How many tubers ride on the belt.
    scene
        singulated, touching, crowded, piled (more than one layer), distractors, two-cameras, two-lane, dropped-frames,
        stop-and-go, changing-speed, tilted, rolling (tubers rock, roll and slide) or rods (a web one sees through).
    camera
        Camera resolution.
    fps
        Frames per second and camera.
    speed_mps
        Belt speed in metres per second.
    belt_distance_m
        Camera to belt along the optical axis, metres.
    preset
        Tubers at rest and a good camera (easy), odd poses, belt height errors and a worse one (field), or a camera, a
        belt and a cultivar drawn from all that real ones showed (harsh), or a camera whose depth a stereo matcher makes
        of two images (matched).
    resting_offset_mm
        How far the whole load lies below the belt plane that the camera sees, beside what rods and cleats do.
    heave_mm
        How far belt and load swing up and down about their mean.
    heave_hz
        How often a second they do.
    depth_unit_mm
        Unit of the depth images.
    travel
        Write the belt's travel as an encoder gives it; --no-travel leaves it to be estimated.
    masks
        Write instance masks too.
    color
        Write colour images too.
    inject
        Faults by name, each its own --inject. Of the camera: dropped, duplicated, frozen, clock-jump, dirty-lens,
        wrong-scale, fine-unit, depth-drift (disparity grows by 0.4 px), mount-moves (6 mm away). Of the picture:
        holes, steep-holes, ragged-edges, smooth-error, fine-noise, coarse-disparity. Of the belt: belt-jitter, rolling.
    format
        folder, mcap (Tuberline's own), ros2 (MCAP with ROS 2 topics), or auto: by the name of --out.
    force
        Overwrite a recording that is there.
    json
        Say what was made as JSON.
    """
    from camera_sim.sim.faults import check_faults
    from camera_sim.sim.optics import optics_named
    from camera_sim.sim.presets import PRESETS
    from camera_sim.sim.record import record_scene
    from camera_sim.sim.scenes import SceneSettings, layout_named
    from conveyor.files import whole_output
    from tuberline.api.recordings import check_ranges
    from tuberline.cli.progress import frames_bar

    layout, faults = layout_named(scene), check_faults(inject)
    check_ranges(seed=seed, tubers=tubers, fps=fps, speed_mps=speed_mps, belt_distance_m=belt_distance_m)
    check_ranges(resting_offset_mm=resting_offset_mm, heave_mm=heave_mm, heave_hz=heave_hz)
    replaced = _replaced(out, force=force)
    settings = SceneSettings(
        scene=scene,
        seed=seed,
        tubers=tubers,
        preset=PRESETS[preset],
        optics=optics_named(camera),
        fps=fps,
        speed_mps=speed_mps,
        belt_distance_m=belt_distance_m,
        unit_m=float(depth_unit_mm) / 1000,
        given_travel=travel,
        resting_offset_mm=resting_offset_mm,
        heave_mm=heave_mm,
        heave_hz=heave_hz,
    )
    with whole_output(out) as partial, frames_bar() as on_frame:
        truth = record_scene(
            partial,
            settings,
            layout=layout,
            masks=masks,
            color=color,
            faults=faults,
            form=format,
            on_frame=on_frame,
        )
        remove(replaced)  # no mix of two recordings
    counted, weight_kg = len(truth["tubers"]), sum(tuber["weight_g"] for tuber in truth["tubers"]) / 1000
    if json:
        sys.stdout.write(json_module.dumps({"out": str(out), "tubers": counted, "weight_kg": weight_kg}) + "\n")
    else:
        sys.stdout.write(f"{out}: {counted} tubers, {weight_kg:.2f} kg, {truth['distractors']} distractors\n")


def _replaced(out: Path, *, force: bool) -> list[Path]:
    """What is there of the recording that the new one takes the place of, on demand alone; it stays until the new one
    is whole. Of a folder what lies in it: the folder may be a disk of its own, or the one in which one works.
    """
    from conveyor.formats.beside import check_new, positions_beside

    former = sorted(out.iterdir()) if out.is_dir() else [out] if out.exists() else []
    is_file = out.suffix == ".mcap" and out.is_file()
    is_recording = is_file or (out / "truth.json").is_file() or any(out.glob("*/camera.json"))
    if former and not is_recording:
        raise InputError(f"{out} exists and is no recording: it is not overwritten; choose another name")
    if not force and (former or not out.is_dir()):
        check_new(out, fix="choose another name or add --force")
    if out.suffix == ".mcap" and not out.is_dir() and (positions := positions_beside(out)).is_file():
        former.append(positions)
    return former
