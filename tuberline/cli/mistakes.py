"""What is said of words that are no command of ours: the mistake, and where the right words stand."""

from __future__ import annotations

from cyclopts import CycloptsPanel
from cyclopts.exceptions import CycloptsError
from rich.console import Group
from rich.panel import Panel
from rich.text import Text


def mistake(error: CycloptsError) -> Panel:
    """The error in a frame, with the help that shows what is allowed."""
    command = " ".join(["tuberline", *(error.command_chain or ())])
    return CycloptsPanel(Group(error, Text(f"What is allowed: {command} --help")))
