"""The power goes: what the file system has not written is lost, and every tuber that a reader saw before is there."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from tests.belts import tuberline
from tests.chaos.harness import canonical
from tests.chaos.test_chaos_resume import begin, tubers
from tests.conftest import wait_until
from tests.conveyor.test_conveyor_orphan import descendants

pytestmark = [pytest.mark.graph, pytest.mark.slow, pytest.mark.timeout(600)]


class Disk:
    """An ext4 file system in a file. The file is the medium: what only the file system's memory holds is not in it."""

    def __init__(self, folder: Path) -> None:
        self.image, self.place = folder / "disk.img", folder / "disk"
        self.place.mkdir()

    def make(self) -> str:
        """'' where it is mounted, else why it cannot be."""
        with self.image.open("wb") as file:
            file.truncate(96 << 20)
        made = subprocess.run(["mkfs.ext4", "-q", self.image], capture_output=True, text=True, check=False)
        return made.stderr.strip() or self.mount()

    def mount(self) -> str:
        words = ["mount", "-o", "loop", self.image, self.place]
        return subprocess.run(words, capture_output=True, text=True, check=False).stderr.strip()

    def unmount(self) -> bool:
        """Whether no one uses it any more."""
        return subprocess.run(["umount", self.place], capture_output=True, check=False).returncode == 0

    def lose_power(self, of: subprocess.Popen[bytes]) -> None:
        """Everything stops in one moment; the disk goes on with what had reached the medium by then."""
        there = [of.pid, *descendants(of.pid)]
        for number in there:
            os.kill(number, signal.SIGSTOP)
        medium = shutil.copy(self.image, self.image.with_suffix(".cut"))
        for number in there:
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        of.wait()
        wait_until(self.unmount, what="the end of all that writes", timeout_s=30)
        Path(medium).replace(self.image)
        assert self.mount() == ""


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    """Skipped, loudly, where no file can be a disk."""
    if os.geteuid() != 0 or not shutil.which("mkfs.ext4"):
        pytest.skip("power loss is not tested: a disk in a file needs root and mkfs.ext4")
    disk = Disk(tmp_path)
    if fault := disk.make():
        pytest.skip(f"power loss is not tested: {fault}")
    yield disk
    wait_until(disk.unmount, what="the end of all that uses the disk", timeout_s=30)


def test_what_a_reader_saw_survives_a_power_cut(recording: Path, run_dir: Path, disk: Disk) -> None:
    out = disk.place / "run"
    for cut, least in enumerate((1, 4, 9)):
        replay = begin(recording, out, "--speed", "0.3", *(["--resume"] if cut else []))
        wait_until(lambda least=least: tubers(out) >= least, what="tubers in the ledger", timeout_s=150)  # type: ignore[misc]
        seen = counted(out)
        disk.lose_power(replay)
        assert len(seen) >= least
        assert seen <= counted(out)
    tuberline("replay", recording, "--out", out, "--resume", "--json")
    assert exported(out) == canonical(run_dir)


def exported(out: Path) -> str:
    """The ledger as it is now."""
    return tuberline("ledger", "export", out / "ledger.db", "--canonical").stdout


def counted(out: Path) -> set[str]:
    """Its tubers, each as one text."""
    return {line for line in exported(out).splitlines() if '"tuber":' in line}
