"""What is said of words that are no command of ours: the mistake, and where the right words stand."""

from __future__ import annotations

from cyclopts import CycloptsPanel
from cyclopts.exceptions import CoercionError, CycloptsError
from rich.console import Group
from rich.panel import Panel
from rich.text import Text

EXAMPLES = {float: "8.61", int: "12"}


def mistake(error: CycloptsError) -> Panel:
    """The error in a frame, with the help that shows what is allowed."""
    if isinstance(error, CoercionError) and error.msg is None and error.token and error.target_type in EXAMPLES:
        error.msg = no_number(error.token.value, error.target_type)
    command = " ".join(["tuberline", *(error.command_chain or ())])
    return CycloptsPanel(Group(error, Text(f"What is allowed: {command} --help")))


def no_number(given: str, kind: type) -> str:
    """Why `given` is no float or int, and how it is written."""
    with_point = given.strip().replace(",", ".")
    try:
        kind(with_point)
        example = with_point
    except ValueError:
        example = EXAMPLES[kind]
    told = "number" if kind is float else "whole number"
    return f'"{given}" is no {told}; write it like {example}.'
