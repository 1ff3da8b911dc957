"""The targets of coverage-guided fuzzing begin: their seeds are made and read. `make fuzz` goes on from there."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import pytest

from conveyor.errors import TuberlineError
from tests.fuzz.targets import TARGETS


@pytest.mark.parametrize("name", TARGETS)
def test_a_target_reads_its_own_seeds(name: str, tmp_path: Path) -> None:
    """That of ROS 1 bags imported its builder from where it had been, and ended before its first input."""
    if name in ("rosbag", "cdr", "mcap"):
        pytest.importorskip("rosbags")
    seeds, read = TARGETS[name](tmp_path)
    assert seeds
    for seed in seeds:
        with suppress(TuberlineError):  # what is refused is refused in words
            read(seed)
