"""A reader's shell: a clean clone in which the blocks of a page are typed in order, perhaps beside a line."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.docs.blocks import made_small
from tests.walks.walk import Walk

STAYS_S = {"page": 5, "viewer": 8, "watch": 8, "top": 5, "recorder": 30, "regressor": 5}
"""Commands that go on until Ctrl-C, which comes after so many seconds; `run` goes on to the end of its page."""
SPEAKS_S = 300
"""The first word of such a command comes within this time on a busy machine."""
READY = {"run": ("segmenter/front: started", "regressor/r1: started", "aggregator: started")}
"""What a line has said when others may ask it."""
ENDS_S = 90
ENDED = (0, 130, -signal.SIGINT)


class Stage(Walk):
    """Commands as a page has them, typed in a clean clone."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.words = {"tcp/10.0.0.1:7447": self.router}
        self._running: list[tuple[str, Path, subprocess.Popen[str]]] = []
        self._make_nothing()

    @property
    def router(self) -> str:
        """Address of this stage's own router."""
        return f"tcp/127.0.0.1:{self._port}"

    def _make_nothing(self) -> None:
        """`make demo` and its like find everything installed."""
        programs = self.clone / ".venv" / "bin"
        programs.mkdir(parents=True)
        for program in (self.clone.parent / "bin").iterdir():
            (programs / program.name).symlink_to(program)
        for stamp in (".installed", ".installed-demo"):
            (self.clone / ".venv" / stamp).touch()

    def do(self, line: str, *, codes: tuple[int, ...] = (0,)) -> None:
        """Type one line of a page, with what stands for something of the reader's own put in."""
        for word, own in self.words.items():
            line = line.replace(word, own)
        *background, last = re.split(r"(?<!&)&(?!&)", made_small(line))
        for part in background:
            self._begin(part.strip())
        if not (last := last.strip()):
            return
        if command(last) in (*STAYS_S, "run"):
            self._begin(last)
            if command(last) in STAYS_S:
                time.sleep(STAYS_S[command(last)])
                self._end()
        else:
            self.type(last, codes=codes)

    def run_python(self, text: str) -> None:
        """Run a page's lines of Python."""
        for word, own in self.words.items():
            text = text.replace(word, own)
        (self.clone / "lines.py").write_text(text, encoding="utf-8")
        self.type("python lines.py")

    def _begin(self, line: str) -> None:
        """Start it; returns when it has said its first word."""
        log = self.clone.parent / f"said-{len(list(self.clone.parent.glob('said-*')))}.log"
        with log.open("w") as file:
            process = subprocess.Popen(
                ["bash", "-c", f"exec {line}"], cwd=self.clone, env=self._env, stdout=file, stderr=subprocess.STDOUT,
                text=True,
            )  # fmt: skip
        self._running.append((line, log, process))
        deadline = time.monotonic() + SPEAKS_S
        first = READY.get(command(line), ("",))
        while not log.stat().st_size or not all(words in log.read_text(encoding="utf-8") for words in first):
            assert process.poll() is None, f"{line} ended with {process.returncode} and said nothing"
            assert time.monotonic() < deadline, f"{line} said nothing within {SPEAKS_S} s"
            time.sleep(0.2)

    def _end(self) -> None:
        """Press Ctrl-C in the newest of those that go on."""
        line, log, process = self._running.pop()
        early = process.poll()
        process.send_signal(signal.SIGINT)
        try:
            code = process.wait(ENDS_S)
        finally:
            process.kill()
        said = log.read_text(encoding="utf-8")
        sys.stdout.write(f"$ {line}   # until Ctrl-C\n{said[-1500:]}\n")
        assert "Traceback" not in said, f"{line}\n{said[-3000:]}"
        assert code in ENDED, f"{line} ended with {code}\n{said[-3000:]}"
        assert early in (None, 0), f"{line} ended by itself with {early}\n{said[-3000:]}"

    def end(self) -> None:
        """Press Ctrl-C in all that still goes on."""
        while self._running:
            self._end()

    def kill(self) -> None:
        """Leave no process behind, whatever happened."""
        for _, _, process in self._running:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for _, _, process in self._running:
            try:
                process.wait(ENDS_S)
            except subprocess.TimeoutExpired:
                process.kill()
        self._running.clear()


def command(line: str) -> str:
    """The name of our command on a line; empty for another program."""
    words = line.split()
    return words[1] if len(words) > 1 and words[0] == "tuberline" else ""
