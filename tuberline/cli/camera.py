"""`tuberline camera`: the node that publishes one camera's frames, and what can be asked of a camera."""

from __future__ import annotations

from cyclopts import App

from tuberline.cli.nodes import camera as publish

camera = App(name="camera", help="Publish the frames of one camera; `camera profile`: measure one.")
camera.default(publish)
camera.command(
    "tuberline.cli.camera_profile:profile",
    name="profile",
    help="Measure noise, steps, holes and bow of a recording's cameras.",
)
