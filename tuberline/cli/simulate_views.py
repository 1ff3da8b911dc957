"""`tuberline simulate-views`: single views of simulated tubers, for training and evaluation."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Literal

from conveyor.errors import InputError
from tuberline.cli.numbers import Many, Seed

Preset = Literal["field", "easy", "harsh", "mixed", "worlds", "exact", "matched"]
ViewCamera = Literal["mixed", "d405-1280", "d405-848"]


def simulate_views(
    *,
    out: Path,
    tubers: Many = 300,
    views: Many = 4,
    seed: Seed = 1,
    preset: Preset = "mixed",
    camera: ViewCamera = "mixed",
    distances: tuple[float, ...] = (0.345, 0.460, 0.465),
    belt_sd_mm: tuple[float, ...] = (),
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
        ones get, drawn by recording (harsh), easy and field by tuber (mixed), all three by recording (worlds), a camera
        that only rounds over shapes of which half are of no cultivar (exact), or one whose depth a stereo matcher makes
        of two images, drawn by recording (matched).
    camera
        Camera resolution; 'mixed' takes both and, in 4 of 10 cases, any belt distance from 0.30 to 0.55 m.
    distances
        Belt distances in metres to choose from.
    belt_sd_mm
        How well belts are known, standard deviations in mm to choose from by recording; views say so, and belts are off
        by as much. Without any it is the preset's: 0.5 to 2.5 mm.
    layout
        pack: `views-*.npz` and `meta.json`. potatotwin: images, clouds and tables as in the 3DPotatoTwin data set, of
        one camera (d405-1280 where none is named), split 60/20/20 into train, val and test.
    force
        Overwrite views that are there.
    """
    from camera_sim.sim.optics import optics_named
    from camera_sim.sim.twinfolder import write_twin_folder
    from camera_sim.sim.viewpack import write_view_pack
    from camera_sim.sim.views import ViewPlan
    from conveyor.files import whole_output
    from tuberline.cli.progress import progress_bar

    if tubers < 1 or views < 1:
        raise InputError(f"--tubers {tubers} --views {views}: both must be at least 1")
    check_distances(distances, needed=True)
    if not all(0.1 <= sd <= 10 for sd in belt_sd_mm):
        raise InputError(f"--belt-sd-mm {belt_sd_mm}: standard deviations of 0.1 to 10 mm are allowed")
    if belt_sd_mm and layout == "potatotwin":
        raise InputError("--belt-sd-mm is for view packs: a 3DPotatoTwin folder cannot say how well its belt is known")
    former = former_views(out, force=force)
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
        belt_sds_m=tuple(sd / 1000 for sd in belt_sd_mm),
    )
    with whole_output(out) as partial, progress_bar() as progress:
        task = progress.add_task("views", total=tubers)
        if layout == "potatotwin":
            made = write_twin_folder(partial, plan, tubers=tubers, on_tuber=lambda _: progress.advance(task))
        else:
            made = write_view_pack(
                partial, plan, tubers=tubers, command=" ".join(sys.argv), on_tuber=lambda _: progress.advance(task)
            )
        remove(former)
    hidden = tubers * views - made
    fewer = f"; in {hidden} of {tubers * views} nothing was left of the tuber, they are not made" if hidden else ""
    sys.stdout.write(f"{made} views of {tubers} tubers in {out}{fewer}\n")


def check_distances(distances: tuple[float, ...], *, needed: bool) -> None:
    """Belt distances are some that a camera can have, and there are some where they are `needed`.

    Raises:
        InputError: they are not.
    """
    if (needed and not distances) or not all(0.2 <= d <= 1.5 for d in distances):
        raise InputError(f"--distances {distances}: belt distances of 0.2 to 1.5 m are allowed")


def remove(former: list[Path]) -> None:
    """Remove what was there before, once what takes its place is made; what it links to stays."""
    for old in former:
        shutil.rmtree(old) if old.is_dir() and not old.is_symlink() else old.unlink(missing_ok=True)


def former_views(out: Path, *, force: bool) -> list[Path]:
    """The views that the new ones take the place of, on demand alone: no mix of two.

    Raises:
        InputError: there are some and `force` is off, or some that were not simulated.
    """
    packs, twin = list(out.glob("views-*.npz")), out / "1_rgbd"
    if (packs or twin.exists()) and not force:
        raise InputError(f"{out} already holds views; choose another folder or add --force")
    if not twin.exists():
        return packs
    if not (twin / "0_camera_intrinsics" / "simulated_camera_intrinsic.json").is_file():
        raise InputError(f"{twin} was not simulated: it is not overwritten")
    return [*packs, twin]
