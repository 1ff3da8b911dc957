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
import logging, os, sys
logging.basicConfig(level=logging.INFO, format="%(message)s")
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
    """Each segmenter of a line compiled all of it on the first start: minutes on a small machine. None said so, and
    `doctor` told to start it and to read its log, which was empty."""
    (tmp_path / "ours.py").write_text(OURS, encoding="utf-8")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    told = []
    for _ in range(2):
        command = [sys.executable, "-c", TOGETHER, str(tmp_path)]
        said = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        assert said.returncode == 0, said.stderr
        told.append((sorted(said.stdout.split()), said.stderr.splitlines()))
    compiling = "compiling what squares need, a minute or two: later starts find it"
    assert told == [(["0", "0", "1"], 3 * [compiling]), (["0", "0", "0"], [])]
    assert [*tmp_path.rglob("compiling-squares.lock")]


CUT_OFF = """
import os, resource, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from numba import config
from numba.core.caching import IndexDataCacheFile
from conveyor.kernels import load_compiler

load_compiler()
sys.dont_write_bytecode = True

def start(before=lambda: None):
    read, write = os.pipe()
    if os.fork() == 0:
        before()
        from ours import squares
        os.write(write, b"%d %d" % (squares(4), sum(squares.stats.cache_misses.values())))
        os._exit(0)
    os.close(write)
    os.wait()
    return os.read(read, 99).decode()

def power_goes():
    IndexDataCacheFile._save_data = lambda *_: os._exit(9)

def disk_is_full():
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

def no_folder():
    config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = "/proc/none", "UserProvidedCacheLocator"

def file(ending):
    return next(Path(os.environ["NUMBA_CACHE_DIR"]).rglob(f"ours.squares-*{ending}"))

def halve(ending):
    os.truncate(file(ending), file(ending).stat().st_size // 2)

assert (start(), start()) == ("30 1", "30 0"), "what was compiled is kept"
for ending in (".nbi", ".nbc"):
    for cut in (halve, lambda ending: os.truncate(file(ending), 0)):
        cut(ending)
        assert start(disk_is_full) == "30 1", "and cannot be mended"
        assert (start(), start()) == ("30 1", "30 0"), ending
ours = Path(sys.argv[1], "ours.py")
ours.write_text(ours.read_text().replace("number * number", "number"))
assert start(power_goes) == "", "an upgrade in place"
assert (start(), start()) == ("10 1", "10 0"), "and not what the older one was compiled to"
assert start(no_folder) == "10 1"
"""


def test_what_a_power_cut_left_of_compiled_kernels_is_compiled_again(tmp_path: Path) -> None:
    """Each start ended at an empty file of numba's, for ever; one cut off within an upgrade ran the older code."""
    (tmp_path / "ours.py").write_text(OURS, encoding="utf-8")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-c", CUT_OFF, str(tmp_path)]
    said = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert said.returncode == 0, said.stderr
    assert "cannot be read, so it is compiled again: Ran out of input" in said.stderr
