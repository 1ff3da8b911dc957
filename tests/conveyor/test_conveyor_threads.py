"""A weight's products take the threads that they are given, and leave NumPy those that it had."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

from threadpoolctl import ThreadpoolController, threadpool_limits

from conveyor.threads import own_threads
from tests.conftest import ROOT

WEIGHED = """
import sys
from conveyor.threads import use_threads
from regressor.serve.form import SIZES_M, made_up_view
from regressor.weigh.prepare import prepare_view
from regressor.weigh.weigher import Weigher
if len(sys.argv) > 1:
    use_threads(int(sys.argv[1]))
weigher = Weigher.load()
print([weigher.network_g(prepare_view(made_up_view(*half_axes_m))) for half_axes_m in SIZES_M])
"""


def counts() -> set[int]:
    """Of NumPy's products; SciPy has a library of its own."""
    libraries = [library for library in ThreadpoolController().info() if library["user_api"] == "blas"]
    return {library["num_threads"] for library in libraries if "scipy.libs" not in library["filepath"]}


def test_one_thread_inside_and_as_many_as_before_when_the_last_has_left() -> None:
    inside, leave = threading.Event(), threading.Event()

    def weigh() -> None:
        with own_threads():
            inside.set()
            leave.wait(30)

    with threadpool_limits(2):
        assert counts() == {2}
        other = threading.Thread(target=weigh)
        other.start()
        assert inside.wait(30)
        with own_threads():
            assert counts() == {1}
        assert counts() == {1}, "another thread still weighs"
        leave.set()
        other.join(30)
        assert counts() == {2}


def test_a_weight_has_the_same_bits_whatever_numpy_takes() -> None:
    def said(threads: str, *words: str) -> str:
        env = {**os.environ, "OMP_NUM_THREADS": threads, "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-c", WEIGHED, *words]
        return subprocess.run(command, capture_output=True, text=True, check=True, env=env, timeout=120).stdout

    assert said("1") == said("2") == said("2", "1")
