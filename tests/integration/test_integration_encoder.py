"""Live cameras that know nothing of the belt, and an encoder that does: through its faults every tuber counts once."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from benchmarks.encoder_line import EncoderLine, cut_power, kill_encoder, lose_count, mute, speak
from tests.belts import simulate

SPEED = 0.3
pytestmark = [pytest.mark.graph, pytest.mark.timeout(300)]


def test_every_tuber_once_though_the_encoder_falls_silent_and_loses_its_count(recording: Path, tmp_path: Path) -> None:
    line = EncoderLine(tmp_path, recording, speed=SPEED)
    line.run([(0.25, mute), (0.4, speak), (0.6, lose_count)])
    encoder = line.nodes["encoder/encoder"]
    cameras = [line.nodes[f"camera/{name}"] for name in line.cameras]
    sys.stdout.write(f"{encoder.values} {[c.values for c in cameras]}\n")
    assert encoder.count("counts_lost") == 1
    assert all(c.count("frames_with_travel") > c.count("frames_without_travel") > 0 for c in cameras)
    assert {c.count("travel_dropped_overwritten") for c in cameras} == {0}
    assert all("the load tells the travel" in line.log(f"camera-{name}") for name in line.cameras)
    summary, tubers = line.summary, line.tubers
    assert summary["balanced"]
    assert len(tubers) <= len(line.places_m)
    if not line.left_out():  # a machine that is too slow says so
        assert len(tubers) == len(line.places_m)
        assert summary["coverage"] > 0.98, "the belt stood until its first frame: no clock, the encoder says so"
    assert sum(len(tuber.cameras) == 2 for tuber in tubers) >= 2
    assert not any("travel_estimated" in tuber.flags for tuber in tubers)


@pytest.mark.slow
@pytest.mark.parametrize("trouble", [kill_encoder, cut_power])
def test_what_dies_goes_on_where_the_load_is_and_counts_nothing_twice(trouble: object, tmp_path: Path) -> None:
    recording = simulate(tmp_path / "belt", scene="two-cameras", tubers="100")
    line = EncoderLine(tmp_path, recording, speed=SPEED)
    line.run([(0.45, trouble)])  # type: ignore[list-item]
    told = [float(m) for m in re.findall(r"tells travel from (\S+) m on", line.log("encoder"))]
    assert len(told) == 2
    assert told[0] == 0.0
    assert told[1] > 0.1, "where the load was"
    tubers, summary, places_m = line.tubers, line.summary, line.places_m
    assert not any("travel_estimated" in tuber.flags for tuber in tubers)
    if trouble is kill_encoder:
        assert len(tubers) == len(places_m)
        assert sum(len(tuber.cameras) == 2 for tuber in tubers) >= 2
    else:
        assert 0 < len(tubers) < len(places_m)
        lost_m = (1 - len(tubers) / len(places_m)) * (max(places_m) - min(places_m))
        assert sum(summary["unseen_m"].values()) == pytest.approx(lost_m, abs=0.12)
