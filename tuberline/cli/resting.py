"""What commands say of the resting level of what they read and weigh by."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from regressor.network.sidecar import Sidecar


def tell_resting(*folders: Path) -> None:
    """One line on stderr for each of `folders` whose tubers are read as lying elsewhere than on their belt.

    Raises:
        InputError: a folder's table states a level that is none.
    """
    from conveyor.formats.potatotwin.resting import resting_told

    for told in dict.fromkeys(map(resting_told, folders)):
        if told:
            sys.stderr.write(f"{told}\n")


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
