"""The pages of docs/ that are made from the code: `make docs` writes them, a test holds them to it."""

from __future__ import annotations

import sys
from pathlib import Path

from cyclopts import App

from tuberline.cli.api_page import api_page, shown
from tuberline.cli.commands import build_app
from tuberline.cli.config_page import config_page
from tuberline.cli.topics import delivery_table, markdown_table

DOCS = Path(__file__).resolve().parents[2] / "docs"
TOPICS_HEAD = """# Topics

Made from `conveyor/topics.py` by `make docs`. Publishers, subscribers, recorder, health and access control come from
the same table. What each delivery promises stands below.

"""
COMMANDS_HEAD = "<!-- Made from the commands themselves by `make docs`. -->\n\n"


def pages() -> dict[str, str]:
    """Text of each page by its name in docs/."""
    from regressor.studies.card import model_card
    from regressor.studies.page import saved_page
    from regressor.studies.saved import Saved

    results = Saved(DOCS / "results")
    return {
        "../regressor/weights/MODEL_CARD.md": model_card(results),
        "evaluation.md": saved_page(results, image="images/evaluation-field.png"),
        "api.md": api_page(DOCS / "examples"),
        "config.md": config_page(),
        "commands.md": COMMANDS_HEAD + _commands() + "\n",
        "topics.md": TOPICS_HEAD + markdown_table() + "\n## Delivery\n" + delivery_table(),
    }


def write_pages(docs: Path) -> None:
    """Write all pages into the folder `docs`."""
    for name, text in pages().items():
        (docs / name).write_text(text, encoding="utf-8")


def _commands() -> str:
    """The command tree as Markdown. Cyclopts puts the running program's name into the usage of sub-commands, so it is
    made to believe that it is `tuberline`.
    """
    program, sys.argv = sys.argv, ["tuberline"]
    try:
        app = build_app(all_listed=True)
        _inherit(app)
        return shown(app.generate_docs(output_format="markdown").rstrip())
    finally:
        sys.argv = program


def _inherit(app: App) -> None:
    """What commands take over from their app when they run, Cyclopts forgets for the page of commands within commands:
    a flag that is off needs no second one.
    """
    for name in app:
        if not name.startswith("-"):
            app[name].default_parameter = app[name].default_parameter or app.default_parameter
            _inherit(app[name])
