"""Compile the kernels once: `make test` begins with it, as else every process of its first tests would compile them.

python -m tests.kernels

What was compiled can be lent to a copy of the repository.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from multiprocessing import get_context
from pathlib import Path

from tests.belts import replay, simulate


def segmenter() -> None:
    """Those of a frame."""
    from segmenter.pipeline import Settings
    from segmenter.warmup import warm_up

    warm_up(Settings().split.pixel_mm)


def regressor() -> None:
    """Those of a view, in both forms of the network."""
    from regressor.network.fast import Form
    from regressor.serve.node import warm_up
    from regressor.weigh.weigher import Weigher

    weigher = Weigher.load(None)
    warm_up(weigher)
    warm_up(weigher.in_form(Form("bfloat16", 64)))


def take_compiled(source: Path, target: Path) -> None:
    """What numba has compiled of files that are the same in both: each process of a fresh clone would take a minute.

    A numba that knows a file by its time and size finds them too: the times are taken along.
    """
    for index in source.glob("[a-z]*/**/__pycache__/*.nbi"):
        module = index.parent.parent / f"{index.name.split('.')[0]}.py"
        same = target / module.relative_to(source)
        if same.is_file() and module.is_file() and same.read_bytes() == module.read_bytes():
            os.utime(same, ns=(module.stat().st_atime_ns, module.stat().st_mtime_ns))
            (same.parent / "__pycache__").mkdir(exist_ok=True)
            for compiled in index.parent.glob(f"{index.name.removesuffix('.nbi')}*.nb?"):
                shutil.copy(compiled, same.parent / "__pycache__")


def main() -> int:
    """Frames and views at the same time, the simulator's, then what only a whole replay calls."""
    compilers = [get_context("spawn").Process(target=target) for target in (segmenter, regressor)]
    for compiler in compilers:
        compiler.start()
    with tempfile.TemporaryDirectory() as folder:
        simulate(Path(folder) / "rods", scene="rods", tubers="2")
        belt = simulate(Path(folder) / "belt", scene="singulated", tubers="3")
        for compiler in compilers:
            compiler.join()
        replay(belt, Path(folder) / "out", "--regressors", "1")
    return max(abs(compiler.exitcode or 0) for compiler in compilers)


if __name__ == "__main__":
    sys.exit(main())
