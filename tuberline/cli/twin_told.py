"""What commands say of a 3DPotatoTwin folder before they read it, and of weights that learned from one."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from regressor.network.sidecar import Sidecar


def tell_twin(*folders: Path) -> None:
    """Lines on stderr for each of `folders`: its resting level, where that is not the belt, and what is left out of it.

    Raises:
        InputError: a folder's table states a level that is none, or cannot be read.
    """
    from conveyor.formats.potatotwin.layout import is_potatotwin
    from conveyor.formats.potatotwin.resting import resting_told
    from conveyor.formats.potatotwin.views import left_out_told

    for folder in dict.fromkeys(folder for folder in folders if is_potatotwin(folder)):
        for told in (resting_told(folder), left_out_told(folder)):
            if told:
                sys.stderr.write(f"{told}\n")


def tell_left_out(folder: Path, words: str) -> None:
    """A line on stderr: which views of a folder a calibration leaves out, by reason."""
    sys.stderr.write(f"{folder}: views left out: {words}\n")


def tell_parts_left_out(left_out: Mapping[str, str]) -> None:
    """A line on stderr for each part of the data, as 'training', whose views are not all taken: which are left out."""
    for part, words in left_out.items():
        if words:
            sys.stderr.write(f"{part} views left out: {words}\n")


def tell_trained_resting(sidecar: Sidecar) -> None:
    """A line on stderr where weights were trained on tubers below their belt, for who states no offset."""
    level = sidecar.training.get("resting")
    if level:
        offset_mm, sd_mm = level["offset_mm"], level["sd_mm"]
        sys.stderr.write(
            f"{sidecar.name} was trained on tubers {offset_mm:g} mm below their belt (sd {sd_mm:g} mm); these are "
            f"weighed as lying on it. Where they were taken as those were, give --resting-offset-mm {offset_mm:g} "
            f"--resting-sd-mm {sd_mm:g}; --resting-offset-mm 0 where not\n"
        )
