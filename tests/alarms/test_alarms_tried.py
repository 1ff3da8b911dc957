"""`tuberline alarms --test` exits with 2 where only a correction helps, and with 75 where another try may do."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from conveyor.errors import PASSING, PERMANENT
from tests.alarms.alarm_words import receiving


def tried(folder: Path, *urls: str) -> tuple[int, str, str]:
    """(exit code, stdout, stderr) of a test of these channels."""
    file = folder / "line.toml"
    given = ", ".join(f'"{url}"' for url in urls)
    file.write_text(f'name = "north"\n[alarms]\nchannels = [{given}]\n', encoding="utf-8")
    command = [sys.executable, "-m", "tuberline", "alarms", str(file), "--test"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    return done.returncode, done.stdout, done.stderr


def test_a_server_that_is_away_may_be_there_at_another_try(free_port: int, tmp_path: Path) -> None:
    """It exited with 2, as a wrong address does."""
    away = f"http://127.0.0.1:{free_port}/x"
    code, out, said = tried(tmp_path, away)
    assert (code, out) == (PASSING, "")
    assert f"http://127.0.0.1:{free_port} did not take it: " in said
    assert "Connection refused" in said
    assert "look whether it runs and this machine reaches it, and try again" in said


@pytest.mark.parametrize(
    ("answer", "code", "fix"),
    [
        (503, PASSING, "look whether it runs"),
        (429, PASSING, "look whether it runs"),
        (404, PERMANENT, "correct its address, path, key or certificate"),
        (401, PERMANENT, "correct its address, path, key or certificate"),
        (422, PERMANENT, "correct its address, path, key or certificate"),
    ],
)
def test_an_answer_says_whether_another_try_may_do(answer: int, code: int, fix: str, tmp_path: Path) -> None:
    with receiving() as server:
        server.answer = answer
        exited, _, said = tried(tmp_path, server.url)
    assert exited == code
    assert f"did not take it: it answers {answer}" in said
    assert fix in said


def test_one_channel_to_correct_outweighs_one_that_is_away(free_port: int, tmp_path: Path) -> None:
    with receiving() as server, receiving() as takes:
        server.answer = 404
        code, out, said = tried(tmp_path, f"http://127.0.0.1:{free_port}/x", server.url, takes.url)
    assert code == PERMANENT
    assert out == f"http://127.0.0.1:{takes.port} took it\n"
    assert said.count("did not take it") == 2
    assert "correct its address" in said
