"""Which format a recording is written in."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from conveyor.errors import InputError

TargetFormat = Literal["auto", "folder", "mcap", "ros2"]


def target_format(target: Path, form: TargetFormat) -> Literal["folder", "mcap", "ros2"]:
    """The format to write `target` in: 'auto' is MCAP for a name that ends in .mcap, else a folder.

    Raises:
        InputError: the name contradicts the format; MCAP files are recognised by their name.
    """
    is_mcap = target.suffix == ".mcap"
    if form == "auto":
        return "mcap" if is_mcap else "folder"
    if is_mcap != (form != "folder"):
        wanted = "must not end in .mcap" if is_mcap else "must end in .mcap"
        raise InputError(f"{target}: for --format {form} the name {wanted}")
    return form
