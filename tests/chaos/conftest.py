"""Chaos tests use the integration tests' recording and undisturbed run, and a longer belt for live cameras."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.integration.conftest import SEED, recording, run_dir, tuberline

__all__ = ["live_recording", "recording", "run_dir"]


@pytest.fixture(scope="session")
def live_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One camera over a belt that takes 6 s to pass, with truth."""
    folder = tmp_path_factory.mktemp("belt") / "live"
    options = {"--seed": SEED, "--scene": "touching", "--tubers": "80", "--fps": "15", "--camera": "d405-848"}
    tuberline("simulate", "--out", folder, *(part for option in options.items() for part in option))
    return folder
