"""`tuberline calibrate`: what a line must know of its own geometry."""

from __future__ import annotations

from cyclopts import App

calibrate = App(name="calibrate", help="Measure the geometry of a line.")
calibrate.command("tuberline.cli.segmentation:calibrate_belt", name="belt", help="Fit the belt's plane to a recording.")
calibrate.command(
    "tuberline.cli.calibrate_load:calibrate_load", name="load", help="Calibrate totals by a scale's ticket."
)
