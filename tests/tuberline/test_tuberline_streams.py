"""A command whose standard output or error is closed says nothing there, and ends with the exit code it has else; one
that draws on a terminal draws what is new.
"""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

from conveyor.config import LineConfig, LinkConfig
from conveyor.node import Node
from tests.aggregator.finished_ledger import copied, flip, write_finished

ROOT = Path(__file__).resolve().parents[2]
CLOSINGS = (">&-", "2>&-", "<&- >&- 2>&-")


def in_shell(words: str, closing: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """A command line as a shell runs it, with some of its streams closed."""
    return subprocess.run(
        ["/bin/sh", "-c", f"exec {sys.executable} -m tuberline {words} {closing}"],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        timeout=120,
    )


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a sound ledger in `sound`, and one with a flipped bit in `damaged`."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "sound").mkdir()
    write_finished(folder / "sound" / "ledger.db")
    damaged = copied(folder / "sound" / "ledger.db", folder / "damaged")
    flip(damaged, damaged.stat().st_size // 2, 3)
    (folder / "line.toml").write_text('name = "north"\n', encoding="utf-8")
    return folder


@pytest.mark.parametrize("closing", CLOSINGS)
@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("--version", 0),
        ("--help", 0),
        ("config check line.toml", 0),
        ("ledger check sound", 0),
        ("ledger check damaged", 1),
        ("ledger dump sound", 0),
        ("ledger totals sound", 0),
        ("audit sound", 0),
        ("info nowhere", 2),
        ("raplay", 2),
    ],
)
def test_the_exit_code_is_the_same_with_closed_streams(words: str, code: int, closing: str, runs: Path) -> None:
    """Closed standard output ended every command with a traceback; with closed standard error `ledger check` of a sound
    ledger ended with 1, which says that it cannot be trusted.
    """
    done = in_shell(words, closing, runs)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    if closing == "2>&-":
        assert done.stdout == in_shell(words, "", runs).stdout


def with_reader_gone(arguments: list[str], folder: Path, *, errors: bool) -> int:
    """The exit code of a command that prints into a pipe whose reader has left before it began."""
    read, write = os.pipe()
    os.close(read)
    try:
        return subprocess.run(
            [sys.executable, *arguments],
            stdout=write,
            stderr=write if errors else subprocess.DEVNULL,
            check=False,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
            timeout=120,
        ).returncode
    finally:
        os.close(write)


@pytest.mark.parametrize("errors", [False, True], ids=["stdout", "both"])
@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("--version", 0),
        ("--help", 0),
        ("config show", 0),
        ("ledger check sound", 0),
        ("ledger check damaged", 1),
        ("ledger dump sound", 0),
        ("ledger dump damaged", 2),
        ("ledger totals sound", 0),
        ("ledger totals sound --json", 0),
        ("load show --ledger sound", 0),
        ("audit sound", 0),
        ("info nowhere", 2),
        ("raplay", 2),
    ],
)
def test_the_exit_code_is_the_same_when_the_reader_has_left(words: str, code: int, errors: bool, runs: Path) -> None:
    """Of a command that printed once it was 0, for the pipe took that, and of one that printed twice 1: `| head -c 1`
    made of a sound ledger's totals a failure, and a fault that `audit` finds has the same code.
    """
    assert with_reader_gone(["-m", "tuberline", *words.split()], runs, errors=errors) == code


@pytest.mark.parametrize(("words", "code"), [(["top"], 0), (["ledger", "dump"], 0), (["audit"], 7)])
def test_a_command_that_only_prints_ends_when_its_reader_has_left(words: list[str], code: int, tmp_path: Path) -> None:
    """`top` would never end; what finds something goes on until it has found it."""
    program = f"""
import sys
from tuberline.cli.streams import outlive_readers
outlive_readers({words})
for _ in range(1000):
    print("x" * 1000, flush=True)
sys.exit(7)
"""
    assert with_reader_gone(["-c", program], tmp_path, errors=False) == code


def test_no_file_gets_the_number_of_a_closed_stream(tmp_path: Path) -> None:
    """A file that is opened later must not be what is written to as standard output or error, here or in a child."""
    code = (
        "import os, subprocess, sys\n"
        "from tuberline.cli.streams import keep_standard_streams\n"
        "keep_standard_streams()\n"
        "with open('kept', 'w') as file:\n"
        "    assert file.fileno() > 2, file.fileno()\n"
        "    os.write(1, b'lost'); os.write(2, b'lost'); print('lost'); print('lost', file=sys.stderr)\n"
        "    assert sys.stdin.read() == ''\n"
        "    done = subprocess.run(['/bin/sh', '-c', 'echo lost; echo lost >&2'])\n"
        "    file.write(f'{done.returncode}')\n"
    )
    shell = f'exec {sys.executable} -c "$CODE" <&- >&- 2>&-'
    done = subprocess.run(
        ["/bin/sh", "-c", shell],
        check=False,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "CODE": code},
        timeout=60,
    )
    assert done.returncode == 0
    assert (tmp_path / "kept").read_text(encoding="utf-8") == "0"


@pytest.mark.graph
def test_top_draws_as_often_as_a_line_reports(link: LinkConfig) -> None:
    """Four times a second it wrote its whole picture: 15 kB/s, which ssh had to carry over any link."""
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "tuberline", "top", "--connect", link.router, "--line", "north"]
    with Node("aggregator", "aggregator", config=LineConfig(name="north", link=link), run="monday") as node:
        env = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "80", "LINES": "24"}
        watching = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=env)
        try:
            written, began_s = b"", 0.0
            deadline = time.monotonic() + 60
            while not began_s or time.monotonic() - began_s < 6:
                assert time.monotonic() < deadline, written
                node.progress()
                if select.select([ours], [], [], 0.1)[0]:
                    written += os.read(ours, 65536)
                    began_s = began_s or time.monotonic()
        finally:
            watching.terminate()
            watching.wait(30)
            os.close(ours)
            os.close(theirs)
    assert 3 <= written.count(b"aggregator") <= 8, written[-2000:]
