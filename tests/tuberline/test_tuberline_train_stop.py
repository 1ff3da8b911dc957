"""Ctrl-C during a training: a real process, a real SIGINT; exit code 130, and words on how to go on."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

from tests.conftest import wait_until
from tests.regressor.ellipsoids import write_pack


def _start(folder: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tuberline", "train", "--data", "train", "--val", "val", "--out", "out"]
    command += ["--epochs", "500", "--batch", "4", *options]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_training_that_is_stopped_says_how_to_go_on(tmp_path: Path) -> None:
    """It said nothing: neither that there was a state, nor that there was none yet."""
    write_pack(tmp_path / "train", tubers=6, views=2, seed=1)
    write_pack(tmp_path / "val", tubers=3, views=1, seed=2)
    for options, ready, words in (
        ((), "cache/clouds-train-*", r"stopped before a first state was written \(--save-minutes\): no training is .*"),
        (
            ("--save-minutes", "0.01"),
            "state.pt",
            r"stopped: --resume goes on from the state in out, .* \d+\.\d min ago",
        ),
    ):
        process = _start(tmp_path, *options)
        wait_until(lambda ready=ready: list((tmp_path / "out").glob(ready)), what=ready)  # type: ignore[misc]
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
        assert process.returncode == 130, err
        assert re.fullmatch(f"tuberline: {words}", err.splitlines()[-1]), err
        assert "Traceback" not in err
