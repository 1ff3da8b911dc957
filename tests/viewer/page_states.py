"""Looks at a line for the page's tests: one in which all is well, and its parts to change."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from conveyor.geometry import Intrinsics
from conveyor.messages import CameraInfo, Counters, Totals
from conveyor.messages.classes import ClassTotal
from conveyor.messages.foreign import ForeignTotal
from conveyor.messages.loads import LoadNow
from viewer.page.state import Flow, LineState, NodeState, PastLoad, ToldLoad

LENS = Intrinsics(848, 480, 430.0, 430.0, 423.5, 239.5)
DOUBT = (
    "contradicts all else that is known: load 1 says 207.100 kg, expected are 181.250 kg, 4.1 standard deviations "
    "apart; it counts for little"
)
HISTOGRAM = (310, 2105, 3420, 2890, 1660, 720, 300, 120, 44, 15, 4, 2)


def counters(node: str, *, values: dict[str, int] | None = None, gauges: dict[str, float] | None = None) -> Counters:
    """A report of `node` ('role/name')."""
    role, _, name = node.partition("/")
    host = "harvester" if role in ("camera", "segmenter") else "edge"
    return Counters(role, name, "monday", 4711, host, "0.1.0", 5000.0, values or {}, gauges or {})


def node(
    name: str, *, values: dict[str, int] | None = None, gauges: dict[str, float] | None = None, **state: Any
) -> NodeState:
    """A node that reported just now."""
    return NodeState(**{"report": counters(name, values=values, gauges=gauges), "age_s": 0.4, "alive": True, **state})


def segmenter(camera: str, *, gauges: dict[str, float] | None = None, **state: Any) -> NodeState:
    """A segmenter at 30 frames a second that lost next to nothing."""
    sheet = {
        "frames_published": 146230.0,
        "frames_received": 146218.0,
        "frames_processed": 146211.0,
        "frames_gaps": 12.0,
        "frames_dropped_too_old": 7.0,
        "views_sent": 34770.0,
        "views_weighed": 34770.0,
        "tracks_counted": 11590.0,
        "frame_age_ms": 38.0,
        "belt_drift_mm": -0.8,
        "belt_alarm": 0.0,
        "log_uncommitted": 2.0,
        **(gauges or {}),
    }
    more = {"per_s": {"frames_processed": 29.9}, "lowest": sheet, "resting_s": {"frames_processed": 0.6}, **state}
    return node(f"segmenter/{camera}", gauges=sheet, **more)


def totals(**changes: Any) -> Totals:
    """A trailer's worth of tubers."""
    count = sum(HISTOGRAM)
    seen = 172.0 * count
    made = Totals(
        run="monday",
        count=count,
        weight_g=seen,
        low_g=0.95 * seen,
        high_g=1.05 * seen,
        coverage=0.985,
        estimated_weight_g=seen / 0.985,
        estimated_low_g=0.955 * seen,
        estimated_high_g=1.075 * seen,
        tubers_per_s=38.2,
        histogram_step_g=50.0,
        histogram=HISTOGRAM,
        cameras={"left": "running", "right": "running"},
        final=False,
    )
    return replace(made, **changes)


def camera_info(camera: str, **changes: Any) -> CameraInfo:
    """A live camera that streams."""
    made = CameraInfo(camera, "monday", "streaming", "RealSense D405", 30.0, False, LENS, 0.0001, 0, 146229, 146230, {})
    return replace(made, **changes)


def good_state(line: str = "north", **changes: Any) -> LineState:
    """A line in which all is well."""
    nodes = {
        "aggregator/aggregator": node("aggregator/aggregator"),
        **{f"camera/{name}": node(f"camera/{name}") for name in ("left", "right")},
        **{f"segmenter/{name}": segmenter(name) for name in ("left", "right")},
        **{
            f"regressor/r{n}": node(
                f"regressor/r{n}",
                values={"views_weighed": 17385},
                gauges={"last_ms": 11.0},
                per_s={"views_weighed": 57.3},
            )
            for n in (1, 2)
        },
    }
    made = LineState(
        line=line,
        heard_s=0.4,
        totals=totals(),
        totals_age_s=0.3,
        nodes=nodes,
        cameras={name: camera_info(name) for name in ("left", "right")},
        flow=Flow(2292.0, 394.0, 0.42),
        loads=tuple(
            PastLoad(f"20261{n}", 1790000000.0 + 3600 * n, 9000 + n, 1.5e6 + 1e4 * n, 1.4e6, 1.6e6, 0.99, True)
            for n in (3, 2, 1)
        ),
    )
    return replace(made, **changes)


def loaded_state(line: str = "north", **changes: Any) -> LineState:
    """The same line with its third load open: a contract's classes, clods among the tubers, a ticket in doubt."""
    edges = ((0.0, 28.0), (28.0, 55.0), (55.0, None))
    classes = tuple(
        ClassTotal(name, low, high, 400, 380, 420, 80e3, 76e3, 84e3, share, share - 1.5, share + 1.5, state)
        for name, (low, high), share, state in zip(
            ("under 28", "28 to 55", "over 55"), edges, (3.0, 61.0, 36.0), ("kept", "open", "broken"), strict=True
        )
    )
    foreign = ForeignTotal(12, 9, 16, 1.0, 0.7, 1.3, 2600, 2000, 3400, 1.1, 0.8, 1.4, {"lump": 10.0, "haulm": 2.0})
    figures = (1200, 206.4e3, 199e3, 214e3, 0.993, 207.9e3, 200e3, 216e3, 206.4e3, 180.0, {})
    now = LoadNow(
        3,
        "trailer 7",
        "7",
        "North 4",
        "Agria",
        "Coop",
        "Anna",
        1790000000.0,
        *figures,
        classes=classes,
        foreign=foreign,
    )
    told = tuple(
        ToldLoad(
            n, f"trailer {n + 4}", "North 4", "Agria", 1790000000.0 + 3600 * n, n == 3, 1200, 206.4e3, 199e3, 214e3,
            0.993, 207.1e3 if n == 1 else None, None, (), doubts=(DOUBT,) if n == 1 else (),
        )
        for n in (3, 2, 1)
    )  # fmt: skip
    said = totals(load=now, contract="packer 2026", classes=classes, foreign=foreign)
    return replace(good_state(line), totals=said, told=told, changed_s=12.0, **changes)


def huge_state(line: str = "the-line-of-the-northern-fields-" + "north" * 6) -> LineState:
    """A day of 1250 t, and loads of 104 t, with names as long as persons make them."""
    name, grams = "Großbäckersheim-Überlingen am See, Schlag 17b hinter Äckern x", 104_218_345.6
    state = loaded_state(line)
    assert state.totals is not None
    assert state.totals.load is not None

    def figures(grams: float) -> dict[str, float]:
        seen = {"weight_g": grams, "low_g": 0.93 * grams, "high_g": 1.07 * grams}
        return {**seen, **{f"estimated_{key}": 1.08 * value for key, value in seen.items()}}

    named = {"name": name, "field": name, "variety": name}
    now = replace(state.totals.load, customer=name, operator=name, count=612_345, **named, **figures(grams))
    told = tuple(
        replace(load, notes=({"by": name, "text": f"{name} {name}"},), net_g=0.99 * grams, weight_g=grams, **named)
        for load in state.told
    )
    run = replace(state.totals, load=now, contract=name, count=7_348_140, **figures(12 * grams))
    return replace(state, totals=run, told=told)


def with_node(state: LineState, name: str, changed: NodeState | None) -> LineState:
    """The look with one node changed, or taken away."""
    others = {key: value for key, value in state.nodes.items() if key != name}
    return replace(state, nodes=others if changed is None else {**others, name: changed})
