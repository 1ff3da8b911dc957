"""The map of a run that goes on, for the page: computed again and again from the run's ledger and positions."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from aggregator.ledger.reader import read_runs, reading
from aggregator.yield_map.no_map import NoMapError, WhyNoMap
from conveyor.config import LineConfig
from conveyor.errors import InputError, TuberlineError
from conveyor.files import told as fault
from conveyor.formats.positions import POSITIONS_FILE
from tuberline.maps.field import FieldMap, Settings, field_map

EVERY_S = 15.0
SHARE = 20.0
"""A map that takes a second is computed every 20 s at most: it is no reason to slow anything down."""
ASSUMED_DELAY_S = 10.0
"""From ground to camera, as long as it is neither given nor found: it takes some opposite passes to find it."""
MOST_CELLS = 4000
Put = Callable[[Sequence[Mapping[str, Any]], Mapping[str, float]], None]
TellWhy = Callable[[str, str], None]
_log = logging.getLogger("page/map")


class LiveMap:
    """Keeps the map of a line whose run is kept on this machine, on its own thread.

    Args:
        put: takes the cells as GeoJSON features, and `low`, `high` and `mean` of them, t/ha.
        tell_why: takes why there are no new ones: a `WhyNoMap` or '' for any other cause, and the text.
    """

    def __init__(self, config: LineConfig, put: Put, tell_why: TellWhy | None = None) -> None:
        gnss = config.gnss
        self._out = config.aggregator.out
        self._settings = None if gnss is None else Settings(
            gnss.width_m, overlap_m=gnss.overlap_m, delay_s=gnss.delay_s, antenna_ahead_m=gnss.antenna_ahead_m
        )  # fmt: skip
        self._put, self._tell_why = put, tell_why
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="map", daemon=True)

    def start(self) -> None:
        """Begin, where the line has a receiver."""
        if self._settings is not None:
            self._thread.start()

    def stop(self) -> None:
        """End it; a map that is being computed is left to the end of the process."""
        self._stop.set()

    def _keep(self) -> None:
        rest_s, said = 1.0, ""
        while not self._stop.wait(rest_s):
            started_s = time.monotonic()
            try:
                self._compute()
                said = ""
            except (TuberlineError, OSError) as error:  # too little was harvested yet, or what a person has to know
                told = fault(error) if isinstance(error, OSError) else str(error)
                if told != said:
                    _log.info("no map: %s", told)
                said = told
                if self._tell_why is not None:
                    self._tell_why(error.why if isinstance(error, NoMapError) else "", said)
            rest_s = max(EVERY_S, SHARE * (time.monotonic() - started_s))

    def _compute(self) -> None:
        assert self._settings is not None, "its thread was started"
        run = newest_run(self._out)
        found = features(live_map(self._out, self._settings, run))
        if newest_run(self._out) == run:  # else these are the cells of the run before
            self._put(*found)


def newest_run(out: Path) -> str:
    """The newest run of the ledger in `out`; '' where there is none."""
    ledger = out / "ledger.db"
    if not ledger.is_file():
        return ""
    with reading(ledger) as db:
        runs = read_runs(db)
    return runs[-1].run if runs else ""


def live_map(out: Path, settings: Settings, run: str) -> FieldMap:
    """The map of a run in `out`.

    Raises:
        NoMapError: there is no run, there are no positions, or too little was harvested.
        InputError: positions that cannot be used.
    """
    if not run:
        raise NoMapError(f"{out} holds no ledger with a run", why=WhyNoMap.NO_LEDGER)
    if not (out / POSITIONS_FILE).is_file():
        raise NoMapError(f"{out} holds no {POSITIONS_FILE}", why=WhyNoMap.NO_POSITIONS)
    try:
        return field_map([out], [], settings, run=run)
    except InputError:
        if settings.delay_s is not None:
            raise
        return field_map([out], [], replace(settings, delay_s=ASSUMED_DELAY_S), run=run)


def features(field: FieldMap, *, most: int = MOST_CELLS) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """The known cells as GeoJSON features with `t_ha`, `low_t_ha`, `high_t_ha`, `tubers`, and the map's range and mean.

    Of more than `most` cells the first ones are left out. To be drawn, a field on the 180th meridian is in one piece.
    """
    cells = field.cells
    known = np.isfinite(cells.t_ha)
    rings = np.round(field.squares(), 7).tolist()
    columns = {"t_ha": cells.t_ha, "low_t_ha": cells.low_t_ha, "high_t_ha": cells.high_t_ha, "tubers": cells.count}
    rows = zip(*(np.round(column[known], 1).tolist() for column in columns.values()), strict=True)
    made = [
        {
            "type": "Feature",
            "geometry": {"type": "Polygon", "coordinates": [ring]},
            "properties": dict(zip(columns, row, strict=True)),
        }
        for ring, row in zip(rings, rows, strict=True)
    ]
    if not made:
        raise NoMapError("no cell of the field is lifted far enough to say anything of it yet", why=WhyNoMap.NO_GROUND)
    told = {"low": np.nanmin(cells.t_ha), "high": np.nanmax(cells.t_ha), "mean": cells.mean_t_ha}
    return made[-most:], {name: round(float(value), 1) for name, value in told.items()}
