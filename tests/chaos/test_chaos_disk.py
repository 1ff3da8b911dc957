"""The ledger's disk is full: the aggregator says so and tries again; with room it ends complete, the same."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from tests.belts import tuberline
from tests.chaos.harness import canonical, site, started

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


def fill(path: Path) -> None:
    """Write until nothing more goes in."""
    with suppress(OSError), path.open("wb", buffering=0) as file:
        while file.write(bytes(4096)):
            pass


def test_a_full_disk_stops_the_count_and_loses_nothing(
    recording: Path, run_dir: Path, small_disk: Path, tmp_path: Path
) -> None:
    ledger, ballast = small_disk / "run", small_disk / "ballast"
    ledger.mkdir()
    settings = {"aggregator": {"out": str(ledger), "exit_when_final": True, "camera_stall_s": 600.0}}
    line_site = site(recording, tmp_path / "run", settings=settings)
    with started(line_site) as line:
        line.wait_count("entries_applied", 2)
        fill(ballast)
        line.wait(lambda: line.supervisor.restarts["aggregator"] >= 2, what="the aggregator's refusals")
        said = line.supervisor.log_tail("aggregator")
        assert line.supervisor.crashes["aggregator"] == 0
        ballast.unlink()
        line.wait(lambda: line.supervisor.finished("aggregator"), what="the summary", timeout_s=150)
    assert "full" in said or "space" in said, said
    assert json.loads((ledger / "summary.json").read_text())["balanced"]
    assert canonical(ledger) == canonical(run_dir)
    assert tuberline("audit", ledger).returncode == 0
