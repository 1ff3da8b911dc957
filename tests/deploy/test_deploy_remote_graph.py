"""`tuberline graph`: the live graph, from values and from a real line."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys

import pytest

from conveyor.config import LineConfig, LinkConfig
from conveyor.messages import Counters
from conveyor.node import Node
from tuberline.cli.address import LineAddress
from tuberline.cli.graph import dot_text, graph, line_graph

NODES = (
    "camera/front",
    "camera/rear",
    "segmenter/front",
    "segmenter/rear",
    "regressor/r1",
    "regressor/r2",
    "aggregator/aggregator",
)


def counters(name: str, *, uptime_s: float, values: dict[str, int], gauges: dict[str, float] | None = None) -> Counters:
    role, _, node = name.partition("/")
    return Counters(
        role=role,
        name=node,
        run="monday",
        pid=7,
        host="edge",
        version="1.2.3",
        uptime_s=uptime_s,
        values=values,
        gauges={"clock_unix_s": 1000.0, **(gauges or {})},
    )


def looks(uptime_s: float, *, frames: int = 0, views: float = 0) -> dict[str, Counters]:
    found = {name: counters(name, uptime_s=uptime_s, values={}) for name in NODES}
    found["camera/front"] = counters("camera/front", uptime_s=uptime_s, values={"frames_published": frames})
    found["segmenter/front"] = counters(
        "segmenter/front",
        uptime_s=uptime_s,
        values={"frame_dropped_overwritten": 3},
        gauges={"views_sent": views, "frame_age_ms": 12.0},
    )
    return found


def test_every_arrow_is_one_the_topic_table_allows() -> None:
    found = line_graph("north", looks(10.0), looks(12.0), alive=set(NODES), now_unix_s=1000.5)
    arrows = {(e.topic, e.sender, e.receiver) for e in found.edges}
    assert ("frame", "camera/front", "segmenter/front") in arrows
    assert ("frame", "camera/front", "segmenter/rear") not in arrows, "a segmenter listens to its own camera"
    assert {a for a in arrows if a[0] == "view"} == {
        ("view", f"segmenter/{c}", f"regressor/{r}") for c in ("front", "rear") for r in ("r1", "r2")
    }
    assert {a for a in arrows if a[0] == "weight"} == {
        ("weight", f"regressor/{r}", f"segmenter/{c}") for c in ("front", "rear") for r in ("r1", "r2")
    }
    assert ("committed", "aggregator/aggregator", "segmenter/rear") in arrows
    assert not [a for a in arrows if a[0] == "counters"]


def test_rates_ages_drops_and_versions() -> None:
    first, last = looks(10.0, frames=100, views=40.0), looks(12.0, frames=160, views=50.0)
    found = line_graph("north", first, last, alive=set(NODES), now_unix_s=1000.5)
    nodes = {node.name: node for node in found.nodes}
    assert nodes["camera/front"].rates_per_s["frames_published"] == 30.0
    assert nodes["segmenter/front"].drops == {"frame_dropped_overwritten": 3.0}
    assert (nodes["segmenter/front"].age_s, nodes["segmenter/front"].frame_age_ms) == (0.5, 12.0)
    assert (nodes["segmenter/front"].version, nodes["segmenter/front"].host) == ("1.2.3", "edge")
    rates = {(e.topic, e.sender): e.rate_per_s for e in found.edges}
    assert rates["frame", "camera/front"] == 30.0
    assert rates["view", "segmenter/front"] == 5.0
    assert rates["camera_info", "camera/front"] is None


def test_who_is_gone_has_no_arrows_and_who_never_reported_is_silent() -> None:
    last = looks(12.0)
    del last["regressor/r2"]
    found = line_graph("north", looks(10.0), last, alive=set(NODES) - {"camera/rear"}, now_unix_s=1000.0)
    states = {node.name: node.state for node in found.nodes}
    assert (states["camera/rear"], states["regressor/r2"], states["camera/front"]) == ("gone", "silent", "ok")
    assert not [e for e in found.edges if e.sender == "camera/rear"]
    assert [e for e in found.edges if e.receiver == "regressor/r2"]


def test_dot_is_what_graphviz_reads() -> None:
    text = dot_text(line_graph("north", looks(10.0), looks(12.0, frames=60), alive=set(NODES), now_unix_s=1000.0))
    assert '"camera/front" -> "segmenter/front" [label="frame 30.0/s\\ncamera_info"];' in text
    if shutil.which("dot"):
        subprocess.run(["dot", "-Tsvg"], input=text, text=True, check=True, capture_output=True, timeout=20)


@pytest.mark.graph
def test_a_real_line(link: LinkConfig, capsys: pytest.CaptureFixture[str]) -> None:
    config = LineConfig(name="north", link=link)
    with (
        Node("camera", "front", config=config, run="monday") as camera,
        Node("segmenter", "front", config=config, run="monday"),
    ):
        camera.counters.add("frames_published", 5)
        graph(address=LineAddress(connect=link.router, line="north"), json=True)
    found = json.loads(capsys.readouterr().out)
    sys.stdout.write(f"{found['nodes']}\n")
    assert [node["state"] for node in found["nodes"]] == ["ok", "ok"]
    assert ["frame", "camera/front", "segmenter/front"] in [
        [edge["topic"], edge["sender"], edge["receiver"]] for edge in found["edges"]
    ]
    assert "frames_published" in found["nodes"][0]["rates_per_s"]


@pytest.mark.graph
def test_two_lines_at_one_router_do_not_see_each_other(link: LinkConfig, capsys: pytest.CaptureFixture[str]) -> None:
    north, south = (LineConfig(name=name, link=link) for name in ("north", "south"))
    with Node("camera", "front", config=north, run="monday"), Node("camera", "rear", config=south, run="monday"):
        graph(address=LineAddress(connect=link.router, line="south"), json=True, wait_s=1.0)
    assert [node["name"] for node in json.loads(capsys.readouterr().out)["nodes"]] == ["camera/rear"]
