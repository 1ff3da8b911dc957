"""`tuberline calibrate`: what a line must know of its own geometry, and what a scale says of its weights."""

from __future__ import annotations

from cyclopts import App

calibrate = App(name="calibrate", help="Measure the geometry of a line; calibrate its weights by a scale.")
calibrate.command(
    "tuberline.cli.calibrate_belt:calibrate_belt", name="belt", help="Fit the belt's plane to a recording."
)
calibrate.command(
    "tuberline.cli.calibrate_cameras:calibrate_cameras", name="cameras", help="Where several cameras hang."
)
calibrate.command(
    "tuberline.cli.calibrate_bucket:calibrate_bucket", name="bucket", help="Calibrate by one bucket that passed."
)
calibrate.command(
    "tuberline.cli.calibrate_tubers:calibrate_tubers", name="tubers", help="Calibrate by single weights in belt order."
)
calibrate.command(
    "tuberline.cli.calibrate_load:calibrate_load", name="load", help="Calibrate totals by a scale's ticket."
)
calibrate.command(
    "tuberline.cli.calibrate_show:show", name="show", help="Each ticket against the others, and what to expect."
)
calibrate.command(
    "tuberline.cli.calibrate_show:set_aside", name="set-aside", help="Take a ticket out of use, for a reason, or back."
)
