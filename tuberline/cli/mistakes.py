"""What is said of words that are no command of ours: the mistake, and where the right words stand."""

from __future__ import annotations

from cyclopts import CycloptsPanel
from cyclopts.exceptions import CycloptsError, MissingArgumentError, UnusedCliTokensError
from rich.console import Group
from rich.panel import Panel
from rich.text import Text


def mistake(error: CycloptsError) -> Panel:
    """The error in a frame, with the help that shows what is allowed."""
    command = " ".join(["tuberline", *(error.command_chain or ())])
    said = _in_words(error, command) or error
    return CycloptsPanel(Group(said, Text(f"What is allowed: {command} --help")))


def _in_words(error: CycloptsError, command: str) -> Text | None:
    """What a command needs that was not given at all, and which words it has no use for; None for other mistakes, and
    for a misspelt option, which Cyclopts tells.
    """
    too_many = [word for word in error.unused_tokens or () if not word.startswith("--")]
    words = f" '{' '.join(too_many)}' was not expected." if too_many else ""
    if isinstance(error, UnusedCliTokensError) and words:
        return Text(f"{command}:{words}")
    missing = isinstance(error, MissingArgumentError) and error.keyword is None and "Did you mean" not in str(error)
    if not missing or error.argument is None or error.argument.tokens:
        return None
    return Text(f"{command} needs {error.argument.name}.{words}")
