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


def settings_of(runs: Sequence[Path], *, width_m: float | None, **given: Any) -> Settings:
    """The settings for these runs; `given` values that are None are taken from [gnss] of the first run's line.toml.

    Raises:
        InputError: the working width is known from nowhere.
    """
    gnss = next((found for found in map(_gnss, runs) if found is not None), None)
    if width_m is None and gnss is None:
        raise InputError(
            "a map needs the working width: give --width-m (two rows of 0.75 m are 1.5), or [gnss] width_m in the "
            "line's config"
        )
    configured = gnss or GnssConfig(source="file:none")
    for name in ("overlap_m", "delay_s", "antenna_ahead_m"):
        if given[name] is None:
            given[name] = getattr(configured, name)
    return Settings(width_m=configured.width_m if width_m is None else width_m, **given)


def _gnss(run: Path) -> GnssConfig | None:
    config = ledger_file(run).parent / CONFIG_FILE
    return load_config(config).gnss if config.is_file() else None
