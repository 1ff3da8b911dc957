"""The camera side's commands: simulate, record, replay, describe. Heavy modules are imported when a command runs."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import Literal

from conveyor.errors import InputError

Preset = Literal["field", "easy", "harsh", "mixed", "worlds"]
TargetFormat = Literal["auto", "folder", "mcap", "ros2"]
ViewCamera = Literal["mixed", "d405-1280", "d405-848"]


def simulate_views(
    *,
    out: Path,
    tubers: int = 300,
    views: int = 4,
    seed: int = 1,
    preset: Preset = "mixed",
    camera: ViewCamera = "mixed",
    distances: tuple[float, ...] = (0.345, 0.460, 0.465),
    layout: Literal["pack", "potatotwin"] = "pack",
    force: bool = False,
) -> None:
    """Make single views of simulated tubers with known weights, for training and evaluation.

    Parameters
    ----------
    out
        Folder to write to.
    tubers
        How many tubers.
    views
        Views per tuber; 31 and more are spread evenly over the image's rows.
    seed
        The same seed gives the same views.
    preset
        How hard: tubers at rest (easy), in any pose with belt height errors (field), cameras and belts as bad as real
        ones get, drawn by recording (harsh), easy and field by tuber (mixed) or all three by recording (worlds).
    camera
        Camera resolution; 'mixed' takes both and, in 4 of 10 cases, any belt distance from 0.30 to 0.55 m.
    distances
        Belt distances in metres to choose from.
    layout
        pack: `views-*.npz` and `meta.json`. potatotwin: images, clouds and tables as in the 3DPotatoTwin data set, of
        one camera (d405-1280 where none is named), split 60/20/20 into train, val and test.
    force
        Overwrite views that are there.
    """
    from rich.progress import Progress

    from camera_sim.sim.optics import optics_named
    from camera_sim.sim.twinfolder import write_twin_folder
    from camera_sim.sim.viewpack import write_view_pack
    from camera_sim.sim.views import ViewPlan
    from tuberline.cli.progress import console

    if tubers < 1 or views < 1:
        raise InputError(f"--tubers {tubers} --views {views}: both must be at least 1")
    if not distances or not all(0.2 <= d <= 1.5 for d in distances):
        raise InputError(f"--distances {distances}: belt distances of 0.2 to 1.5 m are allowed")
    _make_view_room(out, force=force)
    if layout == "potatotwin" and camera == "mixed":
        camera = "d405-1280"
    mixed = camera == "mixed"
    plan = ViewPlan(
        seed=seed,
        views_per_tuber=views,
        preset=preset,
        optics=None if mixed else optics_named(camera),
        distances_m=distances,
        distance_range_m=(0.30, 0.55) if mixed else None,
        fine_unit_share=0.2 if mixed else 0.0,
    )
    with Progress(console=console()) as progress:
        task = progress.add_task("views", total=tubers)
        if layout == "potatotwin":
            made = write_twin_folder(out, plan, tubers=tubers, on_tuber=lambda _: progress.advance(task))
        else:
            made = write_view_pack(
                out, plan, tubers=tubers, command=" ".join(sys.argv), on_tuber=lambda _: progress.advance(task)
            )
    sys.stdout.write(f"{made} views of {tubers} tubers in {out}\n")


def _make_view_room(out: Path, *, force: bool) -> None:
    """Views that are there are only removed on demand: no mix of two."""
    import shutil

    packs, twin = list(out.glob("views-*.npz")), out / "1_rgbd"
    if (packs or twin.exists()) and not force:
        raise InputError(f"{out} already holds views; choose another folder or add --force")
    for old in packs:
        old.unlink()
    if (twin / "0_camera_intrinsics" / "simulated_camera_intrinsic.json").is_file():
        shutil.rmtree(twin)
    elif twin.exists():
        raise InputError(f"{twin} was not simulated: it is not overwritten")


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
    preset: Literal["easy", "field", "harsh"] = "easy",
    resting_offset_mm: float = 0.0,
    heave_mm: float = 0.0,
    heave_hz: float = 4.0,
    depth_unit_mm: Literal["1", "0.1"] = "1",
    travel: bool = True,
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
        belt and a cultivar drawn from all that real ones showed (harsh).
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
        wrong-scale, fine-unit. Of the picture: holes, steep-holes, ragged-edges, smooth-error, fine-noise,
        coarse-disparity. Of the belt: belt-jitter, rolling.
    format
        folder, mcap (Tuberline's own), ros2 (MCAP with ROS 2 topics), or auto: by the name of --out.
    force
        Overwrite a recording that is there.
    json
        Say what was made as JSON.
    """
    from rich.progress import Progress

    from camera_sim.sim.faults import check_faults
    from camera_sim.sim.optics import optics_named
    from camera_sim.sim.presets import PRESETS
    from camera_sim.sim.record import record_scene
    from camera_sim.sim.scenes import SceneSettings, layout_named
    from tuberline.cli.progress import console

    layout, faults = layout_named(scene), check_faults(inject)
    _check_ranges(tubers=tubers, fps=fps, speed_mps=speed_mps, belt_distance_m=belt_distance_m)
    _check_level(resting_offset_mm=resting_offset_mm, heave_mm=heave_mm, heave_hz=heave_hz)
    _make_room(out, force=force)
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
    with Progress(console=console()) as progress:
        task = progress.add_task("frames", total=None)
        truth = record_scene(
            out,
            settings,
            layout=layout,
            masks=masks,
            color=color,
            faults=faults,
            form=format,
            on_frame=lambda done, total: progress.update(task, completed=done, total=total),
        )
    counted, weight_kg = len(truth["tubers"]), sum(tuber["weight_g"] for tuber in truth["tubers"]) / 1000
    if json:
        sys.stdout.write(json_module.dumps({"out": str(out), "tubers": counted, "weight_kg": weight_kg}) + "\n")
    else:
        sys.stdout.write(f"{out}: {counted} tubers, {weight_kg:.2f} kg, {truth['distractors']} distractors\n")


def _check_ranges(*, tubers: int, fps: float, speed_mps: float, belt_distance_m: float) -> None:
    _refuse_beyond(
        ("--tubers", tubers, 1, 100_000),
        ("--fps", fps, 1, 120),
        ("--speed-mps", speed_mps, 0.01, 5),
        ("--belt-distance-m", belt_distance_m, 0.25, 1.5),
    )


def _check_level(*, resting_offset_mm: float, heave_mm: float, heave_hz: float) -> None:
    _refuse_beyond(
        ("--resting-offset-mm", resting_offset_mm, -20, 30),
        ("--heave-mm", heave_mm, 0, 30),
        ("--heave-hz", heave_hz, 0.1, 20),
    )


def _refuse_beyond(*limits: tuple[str, float, float, float]) -> None:
    for name, value, low, high in limits:
        if not low <= value <= high:
            raise InputError(f"{name} {value:g}: allowed is {low:g} to {high:g}")


def _make_room(out: Path, *, force: bool) -> None:
    """An existing recording is only overwritten on demand, and then removed first: no mix of two."""
    import shutil

    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not force:
        raise InputError(f"{out} exists; choose another name or add --force")
    if out.suffix == ".mcap" and out.is_file():
        out.unlink()
        return
    if not (out / "truth.json").is_file() and not any(out.glob("*/camera.json")):
        raise InputError(f"{out} exists and is no recording: it is not overwritten")
    shutil.rmtree(out)


def camera(*, config: Path, camera: str, run: str | None = None) -> None:
    """Publish the frames of one camera of a line.

    Parameters
    ----------
    config
        The line's TOML file.
    camera
        Which of its cameras.
    run
        Id of this run; default: the time of its start. All nodes of a run need the same.
    """
    from camera_sim.node import run_camera
    from conveyor.config import load_config

    run_camera(load_config(config), camera, run or _new_run())


def recorder(*, config: Path, out: Path, run: str | None = None, name: str = "recorder") -> None:
    """Record the frames of all cameras of a running line to MCAP, until stopped. It holds up nobody.

    Parameters
    ----------
    config
        The line's TOML file.
    out
        The file to write; must not exist. After a crash `tuberline recover` saves all but the last second.
    run
        Id of this run, for the counters only.
    name
        Name of this recorder on the line.
    """
    from camera_sim.recorder import run_recorder
    from conveyor.config import load_config

    written = run_recorder(load_config(config), out, run=run or _new_run(), name=name)
    sys.stdout.write(f"{written} frames in {out}\n")


def recover(path: Path, /, *, out: Path | None = None, json: bool = False) -> None:
    """Save what is whole of an MCAP file whose writer was killed, as a new file that every reader takes.

    Parameters
    ----------
    path
        The damaged file; it stays as it is.
    out
        The file to write; default: <name>.recovered.mcap beside it.
    json
        Say what was saved as JSON.
    """
    from conveyor.formats.mcap.recovery import recover as recover_file

    target = out or path.with_name(f"{path.stem}.recovered.mcap")
    saved = recover_file(path, target)
    total = sum(saved.messages.values())
    if json:
        report = {"out": str(target), "messages": saved.messages, "lost_bytes": saved.lost_bytes, "whole": saved.whole}
        sys.stdout.write(json_module.dumps(report) + "\n")
        return
    sys.stdout.write(f"{total} messages saved in {target}\n")
    for topic, count in sorted(saved.messages.items()):
        sys.stdout.write(f"  {topic}: {count}\n")
    if saved.whole:
        sys.stdout.write("the file was whole: nothing was lost\n")
    else:
        sys.stdout.write(f"{saved.lost_bytes} bytes at the end could not be read ({saved.damage})\n")


def info(recording: Path, /, *, json: bool = False) -> None:
    """Describe a recording of any known format and warn of its traps.

    Parameters
    ----------
    recording
        Folder, .mcap file, 3DPotatoTwin folder or ROS bag.
    json
        Print the description as JSON.
    """
    from dataclasses import asdict

    from conveyor.formats.inspection import inspect_recording

    report = inspect_recording(recording)
    if json:
        sys.stdout.write(json_module.dumps(asdict(report), indent=1) + "\n")
        return
    from tuberline.cli.info_table import print_report

    print_report(report)


def convert(
    source: Path,
    target: Path,
    /,
    *,
    format: TargetFormat = "auto",
    belt_distance_m: float | None = None,
    depth_scale_m: float | None = None,
    json: bool = False,
) -> None:
    """Convert a recording of any known format to a folder, to MCAP, or to ROS 2 topics in MCAP; lossless.

    Parameters
    ----------
    source
        A recording of any known format.
    target
        What to write: a name ending in .mcap, or a folder. Must not exist.
    format
        folder, mcap (Tuberline's own), ros2 (MCAP with ROS 2 topics, for ROS and Foxglove), or auto: by the name.
    belt_distance_m
        Instead of what the recording says.
    depth_scale_m
        Metres per depth unit, instead of what the recording says.
    json
        Say what was written as JSON.
    """
    from rich.progress import Progress

    from conveyor.formats.conversion import convert_recording
    from tuberline.cli.progress import console

    with Progress(console=console()) as progress:
        task = progress.add_task("frames", total=None)
        done = convert_recording(
            source,
            target,
            form=format,
            belt_distance_m=belt_distance_m,
            depth_scale_m=depth_scale_m,
            on_frame=lambda done, total: progress.update(task, completed=done, total=total),
        )
    if json:
        report = {"out": str(target), "frames": done.frames, "refused": done.refused}
        sys.stdout.write(json_module.dumps(report) + "\n")
        return
    sys.stdout.write(f"{done.frames} frames in {target}\n")
    for text in done.texts:
        sys.stderr.write(f"refused {text}\n")
    if done.refused:
        sys.stdout.write(f"{sum(done.refused.values())} frames could not be read: {done.refused}\n")


def _new_run() -> str:
    """A run id that says when it began."""
    from datetime import UTC, datetime

    return datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
