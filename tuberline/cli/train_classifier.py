"""The commands that train the segmenter's network."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import Annotated, Any

from conveyor.errors import InputError
from conveyor.files import check_room
from tuberline.cli.numbers import Many, Seed, within


def make_patches(*, data: list[Path], out: Path, force: bool = False) -> None:
    """Make training patches from simulated belts; the belts may be deleted then.

    A training holds all patches in memory, 0.1 MB a body. Making them takes longer than reading them.

    Parameters
    ----------
    data
        Belts made by `tuberline simulate-belts`; may be given more than once.
    out
        Folder of patches-<seed>.npz, one of each pack, for `tuberline train-classifier`.
    force
        Overwrite a file that is there.
    """
    from conveyor.formats.packs.belts import belt_pack_meta, belt_shards

    check_room(out, option="--out")
    for folder in data:
        belt_shards(folder)
    origins = {folder: belt_pack_meta(folder) for folder in data}
    paths: dict[Path, Path] = {}
    for folder, origin in origins.items():
        path = out / f"patches-{origin.get('seed', folder.name)}.npz"
        if path in paths:
            raise InputError(f"{paths[path]} and {folder} would both become {path}; give one --out each")
        if path.exists() and not force:
            raise InputError(f"{path} is there already; choose another folder or add --force")
        paths[path] = folder
    for path, folder in paths.items():
        _cut(folder, path, origins[folder])


def _cut(folder: Path, path: Path, origin: dict[str, Any]) -> None:
    from segmenter.training.cut import cut_pack
    from segmenter.training.samples import write_samples
    from tuberline.cli.progress import frames_bar

    with frames_bar(f"cutting {folder}") as on_shard:
        samples = cut_pack(folder, on_shard=on_shard)
    write_samples(path, samples, origin=origin)
    tubers = sum(sample.is_tuber for sample in samples)
    sys.stdout.write(f"{path}: {tubers} tubers and {len(samples) - tubers} others\n")


def train_classifier(
    *,
    data: list[Path],
    val: Path,
    out: Path,
    start: Path | None = None,
    start_share: float | None = None,
    stretch: Annotated[float, within(0.1, 10)] = 1.0,
    epochs: Many = 40,
    rate: float = 4e-3,
    seed: Seed = 1,
    name: str = "tuberline-classifier",
    json: bool = False,
) -> None:
    """Train the segmenter's network on simulated belts: minutes of two cores.

    Parameters
    ----------
    data
        Belts to learn from, made by `tuberline simulate-belts`, or folders of `tuberline make-patches`; may be given
        more than once.
    val
        Other belts to validate it by.
    out
        Folder of <name>.onnx, for `segmenter.weights` of a line's file, <name>.pt and <name>.json.
    start
        The .pt of an earlier training: learn on from there, on the same belts or on others.
    start_share
        Of the network to start from, in what is written, 0 to 1: keeps what it knew (0).
    stretch
        By which the answers of what is written are multiplied, 0.1 to 10: a mean of two networks is less sure than
        each of them.
    epochs
        Passes over all bodies.
    rate
        Largest learning rate; it rises for 15 % of the steps and falls for the others.
    seed
        Of the first weights and of all draws.
    name
        Name of the files.
    json
        Print the sidecar as JSON on stdout.
    """
    from segmenter.training.classifier_net import ClassifierRecipe
    from segmenter.training.run import TrainingRun, make_classifier
    from tuberline.cli.progress import work_bar

    if not 0 < rate <= 1:
        raise InputError(f"--rate {rate}: above 0, at most 1")
    if start_share is not None and (start is None or not 0 <= start_share <= 1):
        raise InputError(f"--start-share {start_share:g}: from 0 to 1, of the network that --start names")
    _check_out(out, name, start)
    run = TrainingRun(tuple(data), val, out, name, " ".join(["tuberline", *sys.argv[1:]]), start)
    with work_bar("reading belts") as on_work:
        recipe = ClassifierRecipe(epochs=epochs, rate=rate, seed=seed, start_share=start_share or 0.0, stretch=stretch)
        sidecar = make_classifier(
            run, recipe, on_step=lambda step, total, loss: on_work(f"loss {loss:.3f}", step, total)
        )
    if json:
        sys.stdout.write(json_module.dumps(sidecar, indent=1) + "\n")
        return
    sys.stdout.write(f"{out / run.name}.onnx, on belts never seen:\n")
    for what, value in sidecar["held_out"].items():
        sys.stdout.write(f"  {what}: {value:.4g}\n")


def _check_out(out: Path, name: str, start: Path | None) -> None:
    """Before minutes of training: a place to write to, and no other network there than the one that is gone on from."""
    if Path(name).name != name or name in ("", ".."):
        raise InputError(f"--name is {name!r}; allowed is the name of a file without its folder, which --out names")
    check_room(out, option="--out")
    made = [path for ending in (".onnx", ".pt", ".json") if (path := out / f"{name}{ending}").exists()]
    if made and (start is None or start.resolve() != (out / f"{name}.pt").resolve()):
        raise InputError(f"{made[0]} is there already: choose another --out or --name")
