"""A newcomer's shell: a clean clone, the commands of a section of docs/walks.md as they are printed, in order."""

from __future__ import annotations

import csv
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

from conveyor.taken_port import free_port
from tests.docs.blocks import Command, blocks, made_small
from tests.kernels import take_compiled

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 1800
"""Of one command: what takes a minute on a machine of its own takes twenty on a busy one."""
ENDED = "final=True"
"""What the aggregator says of a line whose recording has ended."""


def section(title: str) -> list[str]:
    """The commands under a heading of docs/walks.md, with the sizes of a test."""
    text = (ROOT / "docs" / "walks.md").read_text(encoding="utf-8")
    part = next(part for part in re.split(r"^## ", text, flags=re.MULTILINE) if part.startswith(title))
    return [made_small(block.line) for block in blocks(part) if isinstance(block, Command)]


class Walk:
    """Commands typed in a clean clone, in a terminal of 80 columns."""

    def __init__(self, folder: Path) -> None:
        self.clone = folder / "tuberline"
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(self.clone)], check=True, timeout=LIMIT_S)
        take_compiled(ROOT, self.clone)
        programs = folder / "bin"
        programs.mkdir()
        for name, words in (("python", ""), ("tuberline", "-m tuberline")):
            (programs / name).write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {words} "$@"\n')
            (programs / name).chmod(0o755)
        self._env = {
            **os.environ,
            "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": str(self.clone),
            "OMP_NUM_THREADS": "1",
            "NO_COLOR": "1",
            "COLUMNS": "80",
        }
        self._port = free_port()

    def type(self, line: str, *, codes: tuple[int, ...] = (0,)) -> str:
        """Run one command to its end; what it said.

        Raises:
            AssertionError: another exit code, or a traceback.
        """
        begun, before = time.monotonic(), os.times()
        done = subprocess.run(
            ["bash", "-c", line], cwd=self.clone, env=self._env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, check=False, timeout=LIMIT_S,
        )  # fmt: skip
        cpu_s = sum(os.times()[2:4]) - sum(before[2:4])
        sys.stdout.write(
            f"$ {line}   # {time.monotonic() - begun:.1f} s, {cpu_s:.1f} s of CPU\n{done.stdout[-1500:]}\n"
        )
        assert done.returncode in codes, f"{line} ended with {done.returncode}\n{done.stdout[-3000:]}"
        assert "Traceback" not in done.stdout
        if line.startswith("tuberline init"):
            self._own_port(self.clone / line.split()[2])
        return done.stdout

    def start(self, line: str) -> subprocess.Popen[str]:
        """Start a line in the background; its words go to line.log."""
        log = (self.clone / "line.log").open("w")
        words = shlex.split(line.rstrip("&"))
        return subprocess.Popen(words, cwd=self.clone, env=self._env, stdout=log, stderr=subprocess.STDOUT, text=True)

    def until_ended(self, process: subprocess.Popen[str]) -> None:
        """Wait until its recording has ended, then press Ctrl-C."""
        self.until(ENDED, process)
        process.send_signal(signal.SIGINT)
        assert process.wait(120) == 0, self.log()[-3000:]

    def until(self, words: str, process: subprocess.Popen[str]) -> None:
        """Wait until the line says something."""
        deadline = time.monotonic() + LIMIT_S
        while words not in self.log():
            assert process.poll() is None, self.log()[-3000:]
            assert time.monotonic() < deadline, self.log()[-3000:]
            time.sleep(0.3)

    def log(self) -> str:
        """What the line said."""
        return (self.clone / "line.log").read_text(encoding="utf-8")

    def rows(self, name: str) -> list[dict[str, str]]:
        """A table in the clone."""
        with (self.clone / name).open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))

    def _own_port(self, file: Path) -> None:
        """Other lines may run on this machine: this one takes the router's line into use with a port of its own."""
        text = file.read_text(encoding="utf-8")
        own, found = re.subn(r'# router = "tcp/[^"]+"', f'router = "tcp/127.0.0.1:{self._port}"', text)
        assert found == 1, text
        file.write_text(own, encoding="utf-8")
