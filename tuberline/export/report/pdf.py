"""A report as PDF on A4, set by typst: its own fonts, no network, nothing beside the package."""

from __future__ import annotations

import json
import shutil
import tempfile
from importlib.resources import files
from pathlib import Path
from typing import Any

from conveyor.errors import InputError
from conveyor.extras import needed
from tuberline.export.report.page import Picture, Report, breakable


def report_pdf(report: Report) -> bytes:
    """The whole file. The template reads what is to be set as data: no text of a ledger is taken for markup.

    Raises:
        InputError: typst is not installed, or cannot set this.
    """
    typst = needed("typst", extra="report", what="a report as PDF")
    told = report.as_dict()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for n, (block, values) in enumerate(zip(report.blocks, told["blocks"], strict=True)):
            if isinstance(block, Picture):
                values["png"] = f"picture-{n}.png"
                (folder / values["png"]).write_bytes(block.png)
        (folder / "day.json").write_text(json.dumps(_breakable(told)), encoding="utf-8")
        with files(__package__).joinpath("day.typ").open("rb") as template, (folder / "day.typ").open("wb") as copy:
            shutil.copyfileobj(template, copy)
        try:
            made: bytes = typst.compile(str(folder / "day.typ"), root=scratch)
        except RuntimeError as error:
            raise InputError(f"typst cannot set the report: {error}") from error
    return made


def _breakable(values: Any) -> Any:
    """The same values; long words in all texts may be broken."""
    if isinstance(values, dict):
        return {name: _breakable(value) for name, value in values.items()}
    if isinstance(values, list | tuple):
        return [_breakable(value) for value in values]
    return breakable(values) if isinstance(values, str) else values
