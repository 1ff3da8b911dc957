"""`doctor` of a line with an encoder: whether it tells travel, to whom, and whether its metres are metres."""

from __future__ import annotations

import pytest

from conveyor.config import LineConfig, parse_config
from conveyor.messages import Counters
from tuberline.doctor.encoder import check_encoder
from tuberline.doctor.finding import Finding, Level
from tuberline.doctor.line import check_nodes

CONFIG = parse_config(
    {
        "cameras": {"left": {"source": "realsense", "belt_distance_m": 0.46}},
        "encoder": {"source": "tcp://127.0.0.1:5000", "metres_per_pulse": 0.0005},
    },
    where="test",
)
TELLS = {"tells": 1.0, "travel_m": 12.3456, "belt_mps": 0.412}


def found(
    encoder: dict[str, float] | None,
    *,
    camera: dict[str, float] | None = None,
    segmenter: dict[str, float] | None = None,
    counts: int = 100,
    config: LineConfig = CONFIG,
    gone: str = "",
) -> list[Finding]:
    gauges = {"encoder/encoder": encoder, "camera/left": camera or {}, "segmenter/left": segmenter or {}}
    nodes = {}
    for name, levels in gauges.items():
        if levels is not None:
            values = {"counts": counts, "encoder_lost": 3, "counts_odd": int(levels.get("odd", 0))}
            nodes[name] = Counters(*name.split("/"), "r", 1, "h", "1", 9.0, values, levels)
    return check_encoder(config, nodes, alive=set(nodes) - {gone})


def test_one_that_tells_is_well() -> None:
    (finding,) = found(TELLS)
    assert (finding.level, finding.text) == (Level.OK, "tells travel: 12.35 m, 0.41 m/s now")


@pytest.mark.parametrize(
    ("gauges", "counts", "level", "said"),
    [
        ({"tells": 0.0, "late": 1.0}, 100, Level.WARNING, "the run had begun without it"),
        ({}, 0, Level.FAULT, "no count has come from it (lost 3 times)"),
        ({"tells": 0.0, "odd": 40}, 100, Level.FAULT, "its count jumps (40 of 100 times)"),
        ({"tells": 0.0}, 100, Level.WARNING, "it waits for the segmenters"),
    ],
)
def test_one_that_tells_nothing_says_why(gauges: dict[str, float], counts: int, level: Level, said: str) -> None:
    (finding,) = found(gauges, counts=counts)
    assert finding.level is level
    assert said in finding.text


def test_a_camera_that_does_not_hear_it_is_named() -> None:
    (finding,) = found(TELLS, camera={"encoder_silent_s": 31.0})
    assert finding.level is Level.WARNING
    assert "camera/left has heard nothing from it for 31 s" in finding.text
    (gone,) = found(TELLS, camera={"encoder_silent_s": 31.0}, gone="camera/left")
    assert gone.level is Level.OK, "a camera that is not there any more was named"


@pytest.mark.parametrize(("scale", "level"), [(1.004, Level.OK), (0.95, Level.WARNING)])
def test_its_metres_are_compared_with_the_load(scale: float, level: Level) -> None:
    """Off by 5 % every tuber is counted, and the belt is said to be 5 % longer than it is."""
    (finding,) = found(TELLS, segmenter={"encoder_scale": scale})
    assert finding.level is level
    assert f"the load moves {scale:.3f} m for each metre" in finding.text
    assert ("encoder.metres_per_pulse = 0.000475" in finding.fix) is (level is Level.WARNING)


def test_one_that_is_far_off_is_the_belts_finding() -> None:
    (finding,) = found(TELLS, segmenter={"encoder_scale": 2.0})
    assert finding.level is Level.OK


def test_a_line_without_an_encoder_has_nothing_to_say() -> None:
    assert found(TELLS, config=CONFIG.model_copy(update={"encoder": None})) == []


def test_one_that_is_not_there_is_missed() -> None:
    (finding,) = [f for f in check_nodes(CONFIG, {}, alive=set()) if "encoder" in f.text]
    assert finding.text == "encoder/encoder is not there"
    assert "systemctl start tuberline-encoder@line)" in finding.fix
    (finding,) = [f for f in check_nodes(CONFIG, {}, alive=set()) if "camera" in f.text]
    assert "systemctl start tuberline-camera@line:left)" in finding.fix
