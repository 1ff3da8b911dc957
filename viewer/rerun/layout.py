"""The window: the belt with its tubers, the load in big numbers, the weights, the health of the line."""

from __future__ import annotations

from typing import Any

from viewer.rerun.sdk import rrb
from viewer.scene.primitives import Layout


def blueprint(layout: Layout) -> Any:
    """Rerun's blueprint for these cameras."""
    (x0, x1), (y0, y1) = layout.belt_x_m, layout.belt_y_m
    x, y, size = (x0 + x1) / 2, (y0 + y1) / 2, max(x1 - x0, y1 - y0)
    belt = rrb.Spatial3DView(
        origin="/belt",
        contents=["+ $origin/**", *(f"- /belt/camera/{camera}/color/**" for camera, _, _ in layout.cameras)],
        name="The belt",
        background=[24, 26, 30],
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=(x + 0.1 * size, y - 0.58 * size, 0.5 * size),
            look_target=(x, y - 0.05 * size, 0.0),
            eye_up=(0.0, 0.0, 1.0),
        ),
    )
    pictures = [
        rrb.Spatial2DView(
            origin=f"/belt/camera/{camera}/image",
            contents=["+ $origin/**", "+ /belt/riding/tuber/**"],
            name=f"Camera {camera}",
            visual_bounds=rrb.VisualBounds2D(x_range=[0, width], y_range=[0, height]),
        )
        for camera, width, height in layout.cameras
    ]
    load = rrb.TextDocumentView(origin="/load/page", name="The load")
    weights = rrb.BarChartView(origin="/load/weights", name="How many tubers of which weight (g)")
    # The tiles beneath the field need a network; the field does not.
    field = rrb.Vertical(
        rrb.MapView(origin="/field", name="The field"),
        rrb.TextDocumentView(origin="/field/page", name="t/ha"),
        row_shares=[5, 1],
        name="The field",
    )
    plots = rrb.Tabs(
        rrb.TimeSeriesView(origin="/load", contents=["+ /load/weight_kg", "+ /load/counted_kg"], name="Load, kg"),
        rrb.TimeSeriesView(origin="/tuber/weight_g", name="Each tuber, g"),
        rrb.TimeSeriesView(origin="/load/tubers_per_s", name="Tubers per second"),
        rrb.TimeSeriesView(origin="/load/coverage_percent", name="Belt looked at, %"),
    )
    health = rrb.Tabs(
        rrb.StateTimelineView(origin="/health", name="Nodes"),
        rrb.TextLogView(origin="/log", name="Log"),
    )
    left: Any = (
        rrb.Vertical(belt, rrb.Horizontal(*pictures), row_shares=[1, 1]) if layout.pictures and pictures else belt
    )
    second = rrb.Tabs(field, weights, active_tab=0) if layout.field else weights
    right = rrb.Vertical(load, second, plots, health, row_shares=[4, 3, 3, 2])
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[5, 3]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="capture", play_state="following"),
        auto_views=False,
        auto_layout=False,
    )
