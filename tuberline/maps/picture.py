"""A yield map as a picture: cells in t/ha, the way of the machines, scale bar and what was left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from conveyor.errors import InputError
from conveyor.extras import install_hint
from conveyor.files import whole_output
from tuberline.maps.field import FieldMap

PICTURES = (".png", ".svg", ".pdf", ".jpg")
"""Endings of the names of pictures."""
COLOURS = "YlGn"
INK = "#26332b"


def draw_map(field: FieldMap, out: Path, *, title: str, caption: bool = True) -> None:
    """Write a picture, of the kind that its name ends in (`PICTURES`); `caption`: with what is said of it under it.

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    try:
        import matplotlib as mpl

        mpl.use("Agg")
        from matplotlib import pyplot as plt
    except ImportError as error:
        raise InputError(f"a picture of the map needs matplotlib; {install_hint('map')}") from error
    cells = field.cells
    rows, columns = cells.t_ha.shape
    width_m, height_m = columns * cells.cell_m, rows * cells.cell_m
    tall = height_m / width_m
    across = min(6.0, 7.5 / tall)
    figure, axes = plt.subplots(figsize=(max(across, 4.6) + 1.2, across * tall + 1.3), layout="constrained")
    edges_x, edges_y = (cells.origin_m[i] + np.arange(n + 1) * cells.cell_m for i, n in ((0, columns), (1, rows)))
    known = cells.t_ha[np.isfinite(cells.t_ha)]
    low, high = np.percentile(known, [2, 98]) if len(known) > 2 else (known.min() - 1, known.max() + 1)
    mesh = axes.pcolormesh(edges_x, edges_y, cells.t_ha, cmap=COLOURS, vmin=low, vmax=high)
    for share in field.shares:
        way = np.where(share.points.used[:, None], share.points.xy_m, np.nan)
        axes.plot(way[:, 0], way[:, 1], color=INK, linewidth=0.3, alpha=0.5)
    bar = figure.colorbar(mesh, ax=axes, shrink=0.8, pad=0.02)
    bar.set_label("t/ha", color=INK)
    _scale_bar(axes, cells.origin_m, width_m)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(title, loc="left", color=INK, fontsize=13, fontweight="bold", parse_math=False)
    if caption:
        axes.text(0, -0.02, _caption(field), transform=axes.transAxes, va="top", fontsize=8.5, color=INK)
    with whole_output(out) as path:
        figure.savefig(path, dpi=150, format=out.suffix.lstrip(".").lower())
    plt.close(figure)


def _scale_bar(axes, origin_m, width_m: float) -> None:  # type: ignore[no-untyped-def]
    length = next((step for step in (500, 200, 100, 50, 20, 10) if step <= 0.4 * width_m), 5)
    x, y = origin_m[0], origin_m[1] - 0.015 * width_m
    axes.plot([x, x + length], [y, y], color=INK, linewidth=2, solid_capstyle="butt")
    axes.text(x + length + 0.01 * width_m, y, f"{length} m", va="center", fontsize=8.5, color=INK)


def _caption(field: FieldMap) -> str:
    cells = field.cells
    known = np.isfinite(cells.t_ha)
    half = np.median(((cells.high_t_ha - cells.low_t_ha) / 2)[known])
    used, total = (
        sum(int(values(share)) for share in field.shares)
        for values in (lambda s: s.points.used.sum(), lambda s: len(s.points.time_s))
    )
    delays = ", ".join(f"{s.delay.delay_s:.1f} s ({s.delay.by})" for s in field.shares)
    return (
        f"{cells.mean_t_ha:.1f} t/ha on {cells.area_m2[known].sum() / 1e4:.2f} ha; a cell of {cells.cell_m:g} m is "
        f"known to ±{half:.1f} t/ha, all together to ±{cells.shared_percent:.0f} %\n"
        f"ground to camera: {delays}; {used} of {total} seconds used"
    )
