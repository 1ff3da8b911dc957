"""Freed memory goes back to the system, also where something small lives on between the holes."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

from conveyor.heap import give_back, keep_buffers, resident_mib

HOLES = """
import ctypes
from conveyor.heap import give_back, resident_mib
libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_size_t], [ctypes.c_void_p]
large = []
for _ in range(400):
    large.append(libc.malloc(100_000))
    ctypes.memset(large[-1], 1, 100_000)
    libc.malloc(600)  # stays: an answer in a publisher's cache
full = resident_mib()
for address in large:
    libc.free(address)
freed = resident_mib()
given = give_back()
print(given, full - freed, freed - resident_mib())
"""


def test_holes_between_what_stays_are_given_back() -> None:
    """A regressor grew from 421 to 567 MiB in 10 minutes, all of it free."""
    if platform.libc_ver()[0] != "glibc":
        assert not give_back()
        pytest.skip("this C library keeps no holes that it could give back")
    done = subprocess.run([sys.executable, "-c", HOLES], capture_output=True, text=True, check=True)
    given, by_free_mib, by_giving_back_mib = done.stdout.split()
    assert given == "True"
    assert float(by_free_mib) < 5, "free alone keeps them"
    assert float(by_giving_back_mib) > 30


FRAMES = """
import resource
import numpy as np
from conveyor.heap import keep_buffers
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        images = [np.ones((480, 848), np.float32) for _ in range(6)]
        del images
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
faults()
given_back, kept = faults(), keep_buffers()
faults()
print(kept, given_back, faults())
"""


def test_buffers_of_a_frame_are_used_again_for_the_next() -> None:
    """Pages were returned after each frame and cleared again for the next one: a tenth of a segmenter's time."""
    if platform.libc_ver()[0] != "glibc":
        assert not keep_buffers()
        pytest.skip("this C library decides for itself")
    done = subprocess.run([sys.executable, "-c", FRAMES], capture_output=True, text=True, check=True)
    kept, given_back, faults = done.stdout.split()
    assert kept == "True"
    assert int(faults) < 20 < int(given_back)


def test_resident_memory_is_that_of_this_process() -> None:
    resident = resident_mib()
    assert resident is not None
    assert 5 < resident < 20_000
