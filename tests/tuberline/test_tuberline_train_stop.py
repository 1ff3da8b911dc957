"""Ctrl-C during a training: a real process, a real SIGINT; exit code 130, and words on how to go on."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

from regressor.network.checkpoint import read_checkpoint
from regressor.training.loop import load_state
from tests.conftest import wait_until
from tests.regressor.ellipsoids import write_pack


def _start(folder: Path, *flags: str, out: str = "out", epochs: int = 500) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tuberline", "train", "--data", "train", "--val", "val", "--out", out]
    command += ["--epochs", str(epochs), "--batch", "4", *flags]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _stopped(process: subprocess.Popen[str]) -> str:
    """What a training said that was stopped."""
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    return err


def _words(err: str) -> str:
    return err.splitlines()[-1].removeprefix("tuberline: ")


def test_a_training_that_is_stopped_says_how_to_go_on(tmp_path: Path) -> None:
    """It said nothing: neither that there was a state, nor that there was none yet."""
    write_pack(tmp_path / "train", tubers=60, views=2, seed=1)
    write_pack(tmp_path / "val", tubers=3, views=1, seed=2)
    for options, ready, words in (
        ((), "out", r"stopped before a first state was written \(--save-minutes\): no training is .*"),
        (
            ("--save-minutes", "0.01"),
            "out/state.pt",
            r"stopped: --resume goes on from the state in out, .* \d+\.\d min ago",
        ),
    ):
        process = _start(tmp_path, *options)
        wait_until((tmp_path / ready).exists, what=ready)
        process.send_signal(signal.SIGINT)
        assert re.fullmatch(words, _words(_stopped(process)))
        assert (tmp_path / "out/state.pt").exists() == ("state.pt" in ready)


def test_a_training_that_is_stopped_loses_nothing(tmp_path: Path) -> None:
    """All that was learned since the last --save-minutes was lost, by default up to two minutes of work."""
    write_pack(tmp_path / "train", tubers=6, views=2, seed=1)
    write_pack(tmp_path / "val", tubers=3, views=1, seed=2)
    never = ("--save-minutes", "1e6")
    process = _start(tmp_path, *never, "--validate-minutes", "0.01", epochs=5)
    log = tmp_path / "out/log.csv"
    wait_until(log.exists, what="a validation")
    assert not (tmp_path / "out/state.pt").exists()
    process.send_signal(signal.SIGINT)
    err = _stopped(process)
    assert "stopping after this step, once the state is written; Ctrl-C again stops at once" in err
    assert re.fullmatch(r"stopped: --resume goes on from the state in out, .* 0\.0 min ago", _words(err))
    steps = load_state(tmp_path / "out/state.pt")["progress"]["step"]
    assert int(log.read_text(encoding="utf-8").splitlines()[-1].split(",")[1]) <= steps < 15
    for out, flags in (("out", ("--resume",)), ("unbroken", ())):
        process = _start(tmp_path, *never, *flags, out=out, epochs=5)
        _, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
    stopped, unbroken = (tmp_path / folder / "weights.safetensors" for folder in ("out", "unbroken"))
    assert read_checkpoint(stopped)[1].training["steps"] == 15
    assert stopped.read_bytes() == unbroken.read_bytes()


BUSY = """
import hashlib
from tuberline.cli.stoppable import Request, leave, stoppable
request = Request()
request.heeds.set()
with stoppable(lambda: "stopped", request, on_request=lambda: print("asked", flush=True)):
    print("busy", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"x", b"y", 2**31 - 1)  # compiled, as a step is: Python sees no interrupt
leave()
"""


def test_a_second_ctrl_c_stops_at_once_what_does_not_come_to_its_stop() -> None:
    """Else a training that validates for minutes could only be killed."""
    process = subprocess.Popen([sys.executable, "-c", BUSY], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        for said in ("busy", "asked"):
            assert process.stdout.readline().strip() == said
            process.send_signal(signal.SIGINT)
        assert _words(_stopped(process)) == "stopped"
    finally:
        process.kill()  # it would be busy for hours
