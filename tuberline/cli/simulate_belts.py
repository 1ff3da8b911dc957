"""The command that makes labelled frames of random belts, for training the segmenter's network."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from conveyor.errors import InputError
from tuberline.cli.numbers import Many, Seed, within


def simulate_belts(
    *,
    out: Path,
    belts: Many = 300,
    frames: Many = 8,
    tubers: Many = 20,
    hard_negatives: bool = False,
    matched: Annotated[float, within(0, 1)] = 0.0,
    seed: Seed = 1,
    force: bool = False,
) -> None:
    """Make labelled frames of belts that differ in all that varies, for `tuberline train-classifier`.

    Belt distance, resolution, tilt, noise, relief, soil, crowding, clods, stones and haulm are drawn for each belt.

    Parameters
    ----------
    out
        Folder to write `belts-*.npz` and `meta.json` to.
    belts
        How many belts.
    frames
        Frames of each, 15 to 40 mm of travel apart, while its middle passes.
    tubers
        Tubers on each; distractors come on top.
    hard_negatives
        Every other body is a clod or a stone of a tuber's size, small, knobby and bumpy tubers are frequent, the load
        of two belts in five moves, every second belt is of the world `harsh`, one in ten of `exact`, and frames are 11
        to 21 mm apart: for the classifier.
    matched
        Share of these belts whose camera is of the preset `matched` instead, which matches two images: its errors stay
        on the skin. Only with --hard-negatives.
    seed
        The same seed gives the same frames.
    force
        Overwrite a pack that is there.
    """
    from camera_sim.sim.beltpack import write_belt_pack
    from conveyor.files import whole_output
    from tuberline.cli.progress import progress_bar

    if matched > 0 and not hard_negatives:
        raise InputError("--matched is a share of the belts of --hard-negatives; add that, or leave it out")
    if any(out.glob("belts-*.npz")) and not force:
        raise InputError(f"{out} already holds a pack of belts; choose another folder or add --force")
    with whole_output(out) as partial, progress_bar() as progress:
        task = progress.add_task("belts", total=belts)
        made = write_belt_pack(
            partial,
            belts=belts,
            frames=frames,
            tubers=tubers,
            seed=seed,
            hard_negatives=hard_negatives,
            matched=matched,
            command=" ".join(["tuberline", *sys.argv[1:]]),
            on_belt=lambda _: progress.advance(task),
        )
        for old in out.glob("belts-*.npz"):
            old.unlink()
    sys.stdout.write(f"{made} frames of {belts} belts in {out}\n")
