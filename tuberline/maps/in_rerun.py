"""A yield map for Rerun: cells and the machine's way on its map view."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from conveyor.errors import InputError
from conveyor.extras import install_hint
from conveyor.files import whole_output
from conveyor.geometry import beside_deg
from tuberline.maps.field import FieldMap


def write_rrd(field: FieldMap, out: Path) -> None:
    """Write the map as a Rerun file with a map view; the tiles beneath need a network, the field does not.

    Raises:
        InputError: rerun-sdk is not installed, or the file cannot be written.
    """
    try:
        import rerun as rr
        import rerun.blueprint as rrb
    except ImportError as error:
        raise InputError(f"a map in Rerun needs rerun-sdk; {install_hint('viewer')}") from error
    import matplotlib as mpl

    cells = field.cells
    known = np.isfinite(cells.t_ha)
    lat, lon = field.plane.to_degrees(cells.centres_m()[known])
    middle_deg = field.plane.lon_deg
    values = cells.t_ha[known]
    low, high = np.percentile(values, [2, 98])
    colours = mpl.colormaps["YlGn"](np.clip((values - low) / max(high - low, 1e-9), 0, 1))
    with whole_output(out) as path:
        recording = rr.RecordingStream("tuberline map")
        recording.save(str(path))
        recording.send_blueprint(rrb.Blueprint(rrb.MapView(origin="/field", name="Yield"), collapse_panels=True))
        centres = np.stack([lat, beside_deg(lon, middle_deg)], axis=1)
        points = rr.GeoPoints(lat_lon=centres, radii=cells.cell_m / 2, colors=colours)
        recording.log("field/cells", points, static=True)
        t_ha = rr.AnyValues(t_ha=values, low_t_ha=cells.low_t_ha[known], high_t_ha=cells.high_t_ha[known])
        recording.log("field/cells", t_ha, static=True)
        for share in field.shares:
            lat, lon = field.plane.to_degrees(share.points.xy_m[share.points.used])
            way = (lat, beside_deg(lon, middle_deg))
            recording.log(
                f"field/way/{share.run}",
                rr.GeoLineStrings(lat_lon=[np.stack(way, axis=1)], colors=[60, 60, 60], radii=rr.Radius.ui_points(0.7)),
                static=True,
            )
        recording.flush()
        recording.disconnect()
