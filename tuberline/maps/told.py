"""A map in the terminal: the yield, what each run gave to it, and what was left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console
from rich.text import Text

from tuberline.maps.field import FieldMap


def print_map(field: FieldMap, *, out: Path) -> None:
    """Print mean, interval and area, and what each run gave."""
    console = Console()
    cells = field.cells
    known = np.isfinite(cells.t_ha)
    shared = cells.mean_t_ha * cells.shared_percent / 100
    console.print(
        f"[bold]{cells.mean_t_ha:.1f} t/ha[/] (90 %: {cells.mean_t_ha - shared:.1f} to {cells.mean_t_ha + shared:.1f}) "
        f"on {cells.area_m2[known].sum() / 1e4:.2f} ha, cells of {cells.cell_m:g} m from {cells.t_ha[known].min():.1f} "
        f"to {cells.t_ha[known].max():.1f} t/ha",
        highlight=False,
    )
    for share in field.shares:
        delay = f"{share.delay.delay_s:.1f} s from ground to camera ({share.delay.by})"
        scaled = f", scaled by {share.factor:.3f}" if len(field.shares) > 1 else ""
        used = f"{share.points.used.sum()} of {len(share.points.time_s)} seconds used"
        console.print(Text(f"{share.run}: {share.kg:.0f} kg, {delay}{scaled}; {used}"))
        left = sorted(share.points.reasons().items(), key=lambda item: -item[1])
        if left:
            console.print(f"  left out: {', '.join(f'{n} {why}' for why, n in left)}", highlight=False)
    for share in field.shares:
        if share.lost_kg > 0.001 * share.kg:
            console.print(
                Text(f"warning: {share.lost_kg:.0f} kg of {share.run} passed while the machine's place was not known"),
                style="yellow",
            )
        for why, n in share.faults.items():
            console.print(Text(f"{n} position{'' if n == 1 else 's'} of {share.run} not used: {why}"))
    console.print(Text(f"map: {out}"), soft_wrap=True)  # a path is neither markup nor cut
