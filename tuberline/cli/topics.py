"""`tuberline topics`: the table, for people and for docs/topics.md."""

from __future__ import annotations

import json as json_module
import sys
from collections.abc import Sequence
from dataclasses import asdict

from conveyor.topics import TOPICS, Delivery


def topics(*, json: bool = False, markdown: bool = False) -> None:
    """Print the table of topics.

    Parameters
    ----------
    json
        As JSON.
    markdown
        As a Markdown table, as in docs/topics.md.
    """
    if json:
        sys.stdout.write(json_module.dumps([asdict(topic) for topic in TOPICS], indent=2) + "\n")
    elif markdown:
        sys.stdout.write(markdown_table())
    else:
        from rich.console import Console
        from rich.table import Table

        table = Table("topic", "key under tuberline/<line>/", "from", "to", "delivery", "message")
        for t in TOPICS:
            path = t.path.replace("[", r"\[")
            table.add_row(t.name, path, ", ".join(t.senders), ", ".join(t.receivers), t.delivery.value, t.message)
        Console().print(table)


def markdown_table() -> str:
    """The table of topics as Markdown."""
    head = ("key under `tuberline/<line>/`", "from", "to", "delivery", "message", "what")
    rows = [
        (f"`{t.path}`", ", ".join(t.senders), ", ".join(t.receivers), t.delivery.value, t.message, t.about)
        for t in TOPICS
    ]
    return _table(head, rows)


def delivery_table() -> str:
    """What each class of delivery promises, as Markdown."""
    return _table(("delivery", "what it promises"), [(each.value, each.promise) for each in Delivery])


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, ("---",) * len(head), *rows))
