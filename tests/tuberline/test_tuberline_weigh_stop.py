"""Ctrl-C during a long `weigh`: a real process, a real SIGINT; exit code 130, how many were weighed, no half output."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import wait_until
from tests.regressor.ellipsoids import upper_side

FILES = 4000
"""A fast core weighs some hundred a second, so that no interrupt here comes after the last."""
BELT_M = 0.345


@pytest.fixture
def clouds(tmp_path: Path) -> list[Path]:
    """One cloud of a tuber under many names."""
    first, *others = [tmp_path / f"cloud{n:04}.npy" for n in range(FILES)]
    np.save(first, upper_side(BELT_M))
    for path in others:
        path.hardlink_to(first)
    return [first, *others]


def start(clouds: list[Path], *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tuberline", "weigh", *map(str, clouds)]
    command += ["--belt-distance-m", str(BELT_M), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_kernels(process: subprocess.Popen[str]) -> None:
    """Until it is about to weigh: from then on it may be anywhere in its work."""
    maps = Path(f"/proc/{process.pid}/maps")
    wait_until(lambda: "libllvmlite" in maps.read_text(), what="the compiler of kernels")


def computed_s(process: subprocess.Popen[str]) -> float:
    """Processor time that it has had so far, of all its threads."""
    after_name = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(after_name[11]) + int(after_name[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.parametrize("later_s", [0.0, 1.0])
@pytest.mark.parametrize("options", [(), ("--json",)])
def test_ctrl_c_says_how_many_were_weighed_and_writes_no_halves(
    clouds: list[Path], options: tuple[str, ...], later_s: float
) -> None:
    process = start(clouds, *options)
    wait_for_kernels(process)
    # Where in its work it is must not matter; how far that is, its own processor time says on a busy machine too.
    then_s = computed_s(process) + later_s
    wait_until(lambda: computed_s(process) >= then_s, what=f"{later_s:g} s of its work")
    begun = time.monotonic()
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    took_s = time.monotonic() - begun
    assert process.returncode == 130, err
    last = err.splitlines()[-1]
    told = re.fullmatch(rf"tuberline: stopped: (\d+) of {FILES} were weighed(, nothing was written)?", last)
    assert told is not None, err
    assert "Traceback" not in err
    if options:
        assert out == ""
        assert told[2]
    else:
        assert len(re.findall(r"cloud\d+\.npy", out)) in (0, int(told[1]))
    assert took_s < 10.0, "a second where there is a processor for it"
    sys.stdout.write(f"{last} after {took_s:.2f} s\n")


def test_without_an_interrupt_nothing_is_different(clouds: list[Path]) -> None:
    process = start([clouds[0], clouds[1], clouds[0]], "--json")
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    assert [Path(result["path"]).name for result in json.loads(out)] == ["cloud0000.npy", "cloud0001.npy"]


BUSY = """
import ctypes, signal, threading
from tuberline.cli.stoppable import stoppable
with stoppable(lambda: "stopped: 7 of 9"):
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # this thread's C code sees no signal, as a busy one
    threading.Timer(1.0, lambda: print("busy", flush=True)).start()  # once this thread is in C
    ctypes.CDLL(None).sleep(50)
"""


def test_while_compiled_code_runs_it_is_left_from_outside() -> None:
    process = subprocess.Popen([sys.executable, "-c", BUSY], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "busy\n"
    begun = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=40)
    assert process.returncode == 130
    assert err == "tuberline: stopped: 7 of 9\n"
    assert time.monotonic() - begun < 20.0
