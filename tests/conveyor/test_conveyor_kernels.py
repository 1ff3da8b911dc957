"""What compiles the kernels loads no more than they need."""

from __future__ import annotations

import subprocess
import sys

LOADED = """
import sys
import numpy as np
from conveyor.depth_noise import crop_noise_px
depth = np.full((40, 60), 400, np.uint16)
crop_noise_px(depth, depth_scale_m=0.001, fx=400.0)
assert 'scipy.linalg' not in sys.modules, 'a first kernel'

from numba import njit

@njit
def squared(matrix):
    return np.dot(matrix, matrix)

assert (squared(np.diag([2.0, 3.0])) == np.diag([4.0, 9.0])).all()
assert 'scipy.linalg' in sys.modules, 'a product of matrices'
"""


def test_kernels_load_no_linear_algebra_and_leave_it_to_those_that_need_it() -> None:
    """numba looks for it with a process's first kernel: a quarter of a second of each start."""
    said = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
