"""What compiles the kernels loads no more than they need."""

from __future__ import annotations

import subprocess
import sys

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
