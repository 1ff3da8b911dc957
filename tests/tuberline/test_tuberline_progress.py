"""Long work shows a bar with the time that remains in a terminal, and nothing in a log."""

from __future__ import annotations

import io
import sys

import pytest
from rich.console import Console

from tuberline.cli import progress


@pytest.mark.parametrize("terminal", [False, True])
def test_a_terminal_sees_a_bar_and_a_log_sees_nothing(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.StringIO()
    monkeypatch.setattr(
        progress, "console", lambda: Console(file=out, force_terminal=terminal, width=80, color_system=None)
    )
    with progress.frames_bar() as on_frame:
        for done in range(1, 5):
            on_frame(done, 4)
    said = out.getvalue()
    assert ("frames" in said and "100%" in said) is terminal
    assert terminal or said == ""


def test_a_log_is_a_log(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.frames_bar() as on_frame:
        on_frame(1, 2)
    sys.stderr.flush()
    assert capsys.readouterr().err == ""
