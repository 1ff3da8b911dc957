"""What the first pages tell a newcomer to type is typed here, in order, in an empty folder.

Slow: `pytest -m slow tests/docs/test_docs_run.py`. Sizes are limited by TUBERLINE_DOCS_TUBERS, TUBERLINE_DOCS_VIEWS
and TUBERLINE_DOCS_MINUTES. That every command of every page parses is tested in tests/conveyor/test_conveyor_docs.py.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path

import pytest

from conveyor.config import parse_config
from tests.docs.blocks import Command, File, blocks, made_small

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
RUN = ("first-line.md", "train.md", "reproduce.md")
"""Pages whose blocks are run."""
DONE = "final=True"
"""What the aggregator says of a line whose recording has ended."""
LIMIT_S = 900


@pytest.mark.parametrize("name", RUN)
def test_a_page_that_is_run_has_commands_of_ours_alone(name: str) -> None:
    commands = [part.line for part in blocks(text(name)) if isinstance(part, Command)]
    assert commands
    assert [line for line in commands if not line.startswith("tuberline ")] == [], "fence what is only shown"


@pytest.mark.parametrize("page", sorted(DOCS.glob("*.md")), ids=lambda page: page.name)
def test_every_line_file_on_a_page_is_accepted(page: Path) -> None:
    inside = False
    lines: list[str] = []
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("```"):
            if inside:
                parse_config(tomllib.loads("\n".join(lines)), where=page.name)
            inside, lines = line.startswith("```toml"), []
        elif inside:
            lines.append(line)


def test_sizes_are_limited_and_never_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TUBERLINE_DOCS_TUBERS", "20")
    monkeypatch.setenv("TUBERLINE_DOCS_MINUTES", "0.5")
    assert made_small("tuberline simulate --tubers 300 --seed 300") == "tuberline simulate --tubers 20 --seed 300"
    assert made_small("tuberline simulate --tubers 5") == "tuberline simulate --tubers 5"
    assert made_small("tuberline train --data a") == "tuberline train --data a --minutes 0.5"
    assert made_small("tuberline train --minutes 60 --lr 1") == "tuberline train --minutes 0.5 --lr 1"


def test_blocks_come_in_order_and_fences_are_only_shown() -> None:
    page = '# A\n    tuberline a   # remark\n\n```toml title="b.toml"\nc = 1\n```\n\n'
    page += "```console\nshown\n```\n    tuberline d\n"
    assert list(blocks(page)) == [Command("tuberline a"), File("b.toml", "c = 1\n"), Command("tuberline d")]


def test_the_lines_of_python_in_the_readme_weigh_a_cloud(tmp_path: Path) -> None:
    code = (ROOT / "README.md").read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    points = [
        (x / 1000, y / 1000) for x in range(-40, 41) for y in range(-30, 31) if (x / 40) ** 2 + (y / 30) ** 2 < 0.9
    ]
    rows = [f"{x} {y} {0.345 - 0.03 - 0.03 * (1 - (x / 0.04) ** 2 - (y / 0.03) ** 2) ** 0.5:.5f}" for x, y in points]
    head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\nproperty float x\nproperty float y\nproperty float z\n"
    (tmp_path / "tuber.ply").write_text(head + "end_header\n" + "\n".join(rows) + "\n", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr[-2000:]
    weight_g = float(done.stdout.split(" g")[0])
    assert 110 < weight_g < 230, done.stdout  # an ellipsoid of 80 x 60 x 60 mm has 151 ml


@pytest.mark.slow
@pytest.mark.timeout(3 * LIMIT_S)
@pytest.mark.parametrize("name", RUN)
def test_a_page_runs_from_top_to_bottom(name: str, tmp_path: Path) -> None:
    for part in blocks(text(name)):
        if isinstance(part, File):
            (tmp_path / part.name).write_text(part.text, encoding="utf-8")
            continue
        line = made_small(part.line)
        begun = time.monotonic()
        output = run_line(line, tmp_path) if line.startswith("tuberline run ") else run(line, tmp_path)
        sys.stdout.write(f"$ {line}   # {time.monotonic() - begun:.1f} s\n{output[-600:]}\n")


def text(name: str) -> str:
    """The page `name` of docs/."""
    return (DOCS / name).read_text(encoding="utf-8")


def environment() -> dict[str, str]:
    """The commands' environment: this working tree's packages, one thread."""
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "NO_COLOR": "1"}


def words(line: str) -> list[str]:
    """The command line with this interpreter in place of `tuberline`."""
    return [sys.executable, "-m", *line.split()]


def run(line: str, folder: Path) -> str:
    """Run one command; its output.

    Raises:
        AssertionError: it ended with another code than 0.
    """
    done = subprocess.run(
        words(line),
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=LIMIT_S,
    )
    assert done.returncode == 0, f"{line}\n{done.stdout[-3000:]}"
    return done.stdout


def run_line(line: str, folder: Path) -> str:
    """Run a line until its recording has ended, then press Ctrl-C, as its page says."""
    told: list[str] = []
    finished = threading.Event()
    process = subprocess.Popen(
        words(line), cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )

    def listen() -> None:
        assert process.stdout is not None
        for said in process.stdout:
            told.append(said)
            if DONE in said:
                finished.set()
        finished.set()

    thread = threading.Thread(target=listen, name="listener", daemon=True)
    thread.start()
    try:
        finished.wait(LIMIT_S)
        process.send_signal(signal.SIGINT)
        code = process.wait(60)
    finally:
        process.kill()
        thread.join(10)
    output = "".join(told)
    assert DONE in output, output[-3000:]
    assert code == 0, f"{line} ended with {code}\n{output[-3000:]}"
    return output
