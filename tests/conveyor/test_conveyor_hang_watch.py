"""A test that hangs where its timeout does not reach it is ended and named: CI once waited for one until it gave up."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT

CONFTEST = """
from tests.hang_watch import HangWatch

def pytest_configure(config):
    config.pluginmanager.register(HangWatch(grace_s=1.0))
"""
HANGS = """
import signal, time, pytest

def test_before():
    pass

@pytest.mark.timeout(1)
def test_that_hangs():
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})  # as compiled code does not hear it
    time.sleep(600)

def test_after():
    pass
"""


def run(folder: Path, hanging: str, *options: str) -> subprocess.CompletedProcess[str]:
    (folder / "conftest.py").write_text(CONFTEST)
    (folder / "test_it.py").write_text(hanging)
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *options, str(folder)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTEST_ADDOPTS": ""},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize("workers", [0, 1])
def test_what_hangs_is_ended_and_named_with_the_line_it_hangs_in(tmp_path: Path, workers: int) -> None:
    done = run(tmp_path, HANGS, *(("-n", "1") if workers else ()))
    assert "test_it.py::test_that_hangs did not end within 2 s, nor by its timeout: SIGABRT" in done.stderr
    assert 'test_it.py", line 10 in test_that_hangs' in done.stderr
    assert done.returncode != 0
    if workers:
        assert "crashed while running 'test_it.py::test_that_hangs'" in done.stdout
        assert "1 failed, 2 passed" in done.stdout, "another worker goes on"


def test_what_ends_by_its_timeout_is_left_to_it(tmp_path: Path) -> None:
    done = run(tmp_path, HANGS.replace("{signal.SIGALRM}", "()"))
    assert "1 failed, 2 passed" in done.stdout
    assert "SIGABRT" not in done.stderr
