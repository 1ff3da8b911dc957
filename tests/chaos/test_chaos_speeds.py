"""The same recording gives the same ledger, byte for byte, at any speed and with any number of regressors. By name."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.belts import replay
from tests.chaos.harness import canonical

pytestmark = [pytest.mark.slow, pytest.mark.graph, pytest.mark.timeout(300)]


@pytest.mark.parametrize("regressors", ["1", "2", "4"])
@pytest.mark.parametrize("speed", ["real", "10", "max"])
def test_speed_and_hands_change_nothing(
    recording: Path, run_dir: Path, tmp_path: Path, speed: str, regressors: str
) -> None:
    summary = replay(recording, tmp_path / "run", "--speed", speed, "--regressors", regressors)
    assert summary["balanced"]
    assert canonical(tmp_path / "run") == canonical(run_dir)
