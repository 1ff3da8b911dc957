"""The report of a day from runs to a file."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from aggregator.ledger.totals_by import Total
from conveyor.files import whole_output
from tuberline.export.report.gather import day_facts
from tuberline.export.report.html import report_html
from tuberline.export.report.pdf import report_pdf
from tuberline.export.report.sections import report_of
from tuberline.maps.field import FieldMap


def write_report(
    runs: Sequence[Path],
    out: Path,
    *,
    pdf: bool,
    field: FieldMap | None,
    no_map: str = "",
    day: str | None = None,
    contract: Path | None = None,
) -> Total:
    """Write the report of `day`, whole or not at all; returns what it tells of all loads together.

    Args:
        field: the map, where positions are known; `no_map`: why there is none although they are.
        day: YYYY-MM-DD; None: all that the runs hold. contract: a buyer's classes of size (TOML).

    Raises:
        InputError: no load on that day, or a package is missing.
    """
    facts = day_facts(runs, day=day, contract=contract)
    more = [f"There is no map: {no_map}."] if no_map else []
    if field is not None:
        more += _map_faults(field)
    report = report_of(
        facts,
        map_png=None if field is None else _drawn(field),
        map_note="" if field is None else _told(field),
        more_wrong=more,
    )
    made = report_pdf(report) if pdf else report_html(report).encode()
    with whole_output(out) as path:
        path.write_bytes(made)
    return facts.total


def _drawn(field: FieldMap) -> bytes:
    from tuberline.maps.picture import draw_map

    with tempfile.TemporaryDirectory() as scratch:
        picture = Path(scratch) / "map.png"
        draw_map(field, picture, title="", caption=False)
        return picture.read_bytes()


def _told(field: FieldMap) -> str:
    cells = field.cells
    area_ha = cells.area_m2[np.isfinite(cells.t_ha)].sum() / 1e4
    names = ", ".join(share.run for share in field.shares)
    return f"{cells.mean_t_ha:.1f} t/ha on {area_ha:.2f} ha, all that was lifted in {names}."


def _map_faults(field: FieldMap) -> list[str]:
    return [
        f"{share.lost_kg:.0f} kg of run {share.run} passed while the machine's place was not known."
        for share in field.shares
        if share.lost_kg > 0.01 * share.kg
    ]
