"""How a field is mapped: what was given, else what the line's config says."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from aggregator.ledger.reader import ledger_file
from aggregator.ledger.stated import CONFIG_FILE
from conveyor.config import load_config
from conveyor.config_yield import GnssConfig
from conveyor.errors import InputError
from tuberline.maps.field import Settings

OF_MACHINE = ("width_m", "overlap_m", "delay_s", "antenna_ahead_m")


def settings_of(runs: Sequence[Path], *, places_alone: bool = False, **given: Any) -> list[Settings]:
    """The settings of each run. What is given as None of `OF_MACHINE` is taken from [gnss] of its own line.toml, of a
    run that has none from the first that has one.

    Args:
        places_alone: of tubers are asked for, which the width says nothing of but for the delay that it finds.

    Raises:
        InputError: the working width is known from nowhere.
    """
    found = [_gnss(run) for run in runs]
    usual = next((gnss for gnss in found if gnss is not None), None)
    if given["width_m"] is None and usual is None and not (places_alone and given["delay_s"] is not None):
        raise InputError(
            "a map needs the working width: give --width-m (two rows of 0.75 m are 1.5), or [gnss] width_m in the "
            "line's config" + ("; to place tubers --delay-s will do, which else is found by it" if places_alone else "")
        )
    others = usual or GnssConfig(source="file:none")
    return [
        Settings(**given | {name: getattr(gnss or others, name) for name in OF_MACHINE if given[name] is None})
        for gnss in found
    ]


def _gnss(run: Path) -> GnssConfig | None:
    config = ledger_file(run).parent / CONFIG_FILE
    return load_config(config).gnss if config.is_file() else None
