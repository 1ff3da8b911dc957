"""The ledger's disk is full: the aggregator stops, loudly; with room again the ledger ends complete and the same."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.chaos.harness import DisturbedLine, canonical, disturbed_replay

pytestmark = [pytest.mark.graph, pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 2 MiB; skipped, loudly, where none can be mounted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if os.geteuid() != 0:
        pytest.skip("a full disk is not tested: mounting a small tmpfs needs root")
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(folder)], capture_output=True, text=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"a full disk is not tested: {mounted.stderr.strip()}")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_full_disk_stops_the_count_and_loses_nothing(
    recording: Path, run_dir: Path, small_disk: Path, tmp_path: Path
) -> None:
    ledger, ballast = small_disk / "run", small_disk / "ballast"
    said: list[str] = []

    def disturb(line: DisturbedLine) -> None:
        line.wait_count("entries_applied", 2)
        with ballast.open("wb") as file:
            try:
                while True:
                    file.write(bytes(4096))
                    file.flush()
            except OSError:
                pass
        line.wait(lambda: line.supervisor.restarts["aggregator"] or line.supervisor.failures, what="a refusal")
        said.append((tmp_path / "run" / "logs" / "aggregator.log").read_text())
        ballast.unlink()
        line.supervisor.revive("aggregator")

    summary = disturbed_replay(
        recording,
        tmp_path / "run",
        disturb,
        settings={"aggregator": {"out": str(ledger), "exit_when_final": True, "camera_stall_s": 600.0}},
        summary_in=ledger,
    )
    assert "full" in said[0].lower() or "space" in said[0].lower()
    assert summary["balanced"]
    assert canonical(ledger) == canonical(run_dir)
