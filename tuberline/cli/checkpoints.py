"""`tuberline import-checkpoint` and `export-onnx`: weights from and for other programs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

from conveyor.errors import InputError
from tuberline.cli.numbers import Seed, within


def import_checkpoint(
    path: Path, /, *, out: Path, name: str | None = None, start: Literal["random", "prefix"] = "random", seed: Seed = 0
) -> None:
    """Take over the authors' checkpoint (pointraft_potato.pth) as .safetensors with a sidecar.

    Parameters
    ----------
    path
        The .pth file.
    out
        The .safetensors file to write; its sidecar goes beside it.
    name
        Of the weights, as it will stand in ledgers; default: the file's name.
    start
        Where sampling starts. The authors' network was trained with random starts: keep 'random' for it.
    seed
        Of the random starts.
    """
    from conveyor.files import whole_output
    from regressor.network.checkpoint import load_checkpoint, save_checkpoint
    from regressor.network.sidecar import StartPolicy, checked_name

    if out.suffix != ".safetensors":
        raise InputError(f"--out {out} must end in .safetensors")
    if path.suffix == ".safetensors":
        raise InputError(f"{path} are weights of Tuberline already: give them as they are, with --weights")
    model, sidecar = load_checkpoint(path)
    changes = {"name": checked_name(name or sidecar.name), "start": StartPolicy(kind=start, seed=seed)}
    with whole_output(out) as partial:
        written = save_checkpoint(partial, model.state_dict(), sidecar.model_copy(update=changes))
    sys.stderr.write(f"{out}: {written.model_id}, {len(model.state_dict())} entries, start policy '{start}'\n")


def export_onnx(
    *, out: Path, weights: Path | None = None, batch: Annotated[int | None, within(1, 4096)] = None
) -> None:
    """Export all that makes a weight to one ONNX file: network, volume rule, blend, interval; the sidecar beside it.

    Parameters
    ----------
    out
        The .onnx file to write.
    weights
        A .safetensors or an upstream .pth file; default: the shipped ones.
    batch
        Fix the batch size; default: any.
    """
    from conveyor.files import whole_output
    from regressor.network.checkpoint import load_checkpoint
    from regressor.network.export import export_onnx as write
    from regressor.network.stored import SHIPPED
    from regressor.serve.messages import SUFFIXES
    from tuberline.cli.progress import work_bar

    if out.suffix != ".onnx":
        raise InputError(f"--out {out} must end in .onnx")
    model, sidecar = load_checkpoint(weights)
    for other in (out.with_suffix(suffix) for suffix in SUFFIXES):
        if other.is_file() and not other.samefile(weights or SHIPPED):
            raise InputError(
                f"--out {out}: its sidecar {out.with_suffix('.json').name} would take the place of that of {other}; "
                "choose another name"
            )
    with whole_output(out) as partial, work_bar("ONNX") as on_work:
        on_work("tracing the network", 0, None)
        write(partial, model, sidecar, batch=batch)
    sys.stderr.write(f"{out}: {sidecar.model_id}, batch {batch or 'open'}; an example: docs/examples/onnx_outside.py\n")
