"""What compiles the kernels loads no more than they need."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

LOADED = """
import sys
import numpy as np
from regressor.serve.node import warm_up as warm_up_views
from regressor.weigh.weigher import Weigher
from segmenter.pipeline import Settings
from segmenter.warmup import warm_up as warm_up_frames

warm_up_frames(Settings().split.pixel_mm)
warm_up_views(Weigher.load())
assert 'scipy.linalg' not in sys.modules, 'a frame and a view'

from numba import njit

@njit
def squared(matrix):
    return np.dot(matrix, matrix)

assert (squared(np.diag([2.0, 3.0])) == np.diag([4.0, 9.0])).all()
assert 'scipy.linalg' in sys.modules, 'a product of matrices'
"""


def test_a_frame_and_a_view_load_no_linear_algebra_and_a_kernel_that_needs_it_finds_it() -> None:
    """numba looks for it with a process's first kernel: a quarter of a second of each start."""
    said = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr


TOGETHER = """
import os, sys
sys.path.insert(0, sys.argv[1])
from conveyor.kernels import compiled_once, load_compiler
from ours import squares

load_compiler()
for _ in range(3):
    if os.fork() == 0:
        with compiled_once("squares"):
            assert squares(4) == 30
        os.write(1, b"%d\\n" % sum(squares.stats.cache_misses.values()))
        os._exit(0)
assert [os.wait()[1] for _ in range(3)] == [0, 0, 0]
"""
OURS = """
from conveyor.kernels import kernel

@kernel()
def squares(most):
    found = 0
    for number in range(most + 1):
        found += number * number
    return found
"""


def test_of_processes_that_begin_together_one_compiles(tmp_path: Path) -> None:
    """Each segmenter of a line compiled all of it on the first start: minutes on a small machine."""
    (tmp_path / "ours.py").write_text(OURS, encoding="utf-8")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    told = []
    for _ in range(2):
        command = [sys.executable, "-c", TOGETHER, str(tmp_path)]
        said = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        assert said.returncode == 0, said.stderr
        told.append(sorted(said.stdout.split()))
    assert told == [["0", "0", "1"], ["0", "0", "0"]]
    assert [*tmp_path.rglob("compiling-squares.lock")]
