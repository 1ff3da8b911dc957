"""A regressor that holds the interpreter lock: alive to the network, deaf to everything. Its views go to another."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay

pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]
STUCK = Path(__file__).parent / "stuck"


@pytest.fixture
def lock_holders(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes started from here on hold the interpreter lock when they are told to."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(STUCK), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep))


def at_work(line: DisturbedLine) -> None:
    """Views are sent, and the first regressor takes them."""
    line.wait(lambda: "regressor/r1" in line.observer.alive(), what="the first regressor", timeout_s=120)
    line.wait_count("views_sent", 3)


@pytest.mark.slow
@pytest.mark.usefixtures("lock_holders")
def test_one_that_holds_the_interpreter_lock_for_3_s_and_one_frozen_for_4_s_change_nothing(
    recording: Path, run_dir: Path, tmp_path: Path
) -> None:
    """The first keeps its token, the second loses it and comes back with answers that no one needs."""

    def disturb(line: DisturbedLine) -> None:
        at_work(line)
        line.signal("regressor-r1", signal.SIGUSR1)
        line.wait_count("views_requeued_deadline", 1)
        assert "regressor/r1" in line.observer.alive(), "its token is gone: that is a dead process, not a stuck one"
        line.freeze("regressor-r2", 4.0)

    # Its 2.8 s at a quarter of their speed: views must still come when the first is stuck.
    settings = {"segmenter": {"job_deadline_s": 1.0}}
    summary = disturbed_replay(recording, tmp_path / "run", disturb, speed=0.25, settings=settings)
    assert summary["balanced"]
    assert (summary["restarts"]["regressor-r1"], summary["restarts"]["regressor-r2"]) == (0, 0)
    assert canonical(tmp_path / "run") == canonical(run_dir)


@pytest.mark.slow
@pytest.mark.usefixtures("lock_holders")
def test_the_only_regressor_that_never_lets_go_of_the_lock_ends_itself_and_is_started_again(
    recording: Path, run_dir: Path, tmp_path: Path
) -> None:
    """No Python thread of it can notice: the watchdog is a thread of C that the others have to keep quiet."""

    def disturb(line: DisturbedLine) -> None:
        at_work(line)
        line.signal("regressor-r1", signal.SIGUSR2)
        line.wait(lambda: line.supervisor.restarts["regressor-r1"], what="the watchdog", timeout_s=90)

    summary = disturbed_replay(recording, tmp_path / "run", disturb, regressors=1)
    assert summary["balanced"]
    assert "sitecustomize" in (tmp_path / "run" / "logs" / "regressor-r1.log").read_text(), "where it was stuck"
    assert canonical(tmp_path / "run") == canonical(run_dir)
