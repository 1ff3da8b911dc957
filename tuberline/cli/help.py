"""How help is laid out: commands as plain lines that fit one screen, options in boxes."""

from __future__ import annotations

import textwrap
from typing import Any

from cyclopts.help import HelpPanel
from cyclopts.help.formatters import DefaultFormatter
from rich.console import Console, ConsoleOptions
from rich.text import Text

INDENT = 2


class PlainHelp:
    """Lists of commands without frames; tables of options as Cyclopts draws them."""

    def __init__(self) -> None:
        self._options = DefaultFormatter()

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
        """Draw one panel."""
        if panel.format == "command":
            _commands(console, panel)
        else:
            for entry in panel.entries:
                _join_lines(entry.description)
            self._options(console, options, panel)

    def render_usage(self, console: Console, options: ConsoleOptions, usage: Any) -> None:
        """The line of usage."""
        words = str(usage).strip()
        console.print(Text(words if words.startswith("Usage:") else f"Usage: {words}"), soft_wrap=True)
        console.print()

    def render_description(self, console: Console, options: ConsoleOptions, description: Any) -> None:
        """What the command is for."""
        console.print(description)


def _commands(console: Console, panel: HelpPanel) -> None:
    entries = [
        (" ".join(entry.positive_names[:1] + entry.positive_shorts), _plain(entry.description))
        for entry in panel.entries
    ]
    if not entries:
        return
    console.print(Text(f"{_plain(panel.title)}:", style="bold"))
    width = max(10, *(len(name) for name, _ in entries))
    for name, about in entries:
        room = max(20, console.width - width - INDENT - 2)
        first, *further = textwrap.wrap(about, room) or [""]
        console.print(Text(" " * INDENT) + Text(f"{name:<{width}}  ", style="cyan") + Text(first), soft_wrap=True)
        for line in further:
            console.print(Text(" " * (INDENT + width + 2) + line), soft_wrap=True)


def _join_lines(description: Any) -> None:
    """Let the table break the lines: where the source breaks them says nothing."""
    text = getattr(description, "primary_renderable", None)
    if isinstance(text, Text):
        description.primary_renderable = Text(" ".join(text.plain.split()))


def _plain(thing: Any) -> str:
    """The words of a description, of whichever kind Cyclopts made it."""
    if thing is None:
        return ""
    found = getattr(thing, "plain", None) or getattr(getattr(thing, "primary_renderable", None), "plain", None)
    return str(found if found is not None else thing).strip()
