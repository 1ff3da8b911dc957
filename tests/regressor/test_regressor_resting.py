"""The resting level between rods: the sink of a tuber's outline against the stable poses of whole tubers."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from camera_sim.sim.lowering import Support, settled, underside_of
from camera_sim.sim.meshes import rotation_about
from camera_sim.sim.poses import rest_on_belt, resting_rotation
from camera_sim.sim.rods import Rods
from camera_sim.sim.tubers import draw_tuber
from conveyor.config import BeltConfig, parse_config
from conveyor.errors import ConfigError, MessageError
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.resting import RestingLevel, ellipse_sink_m
from regressor.training.labelled import read_labelled
from tests.regressor.ellipsoids import ellipsoid_view
from tests.regressor.twin_folder import write_twin
from tuberline.cli.simulate_views import simulate_views


@pytest.mark.parametrize(("radius_mm", "sink_mm"), [(20, 9.7), (28, 6.6), (40, 4.6)])
def test_a_sphere_sinks_as_the_facts_say(radius_mm: float, sink_mm: float) -> None:
    radius_m = radius_mm / 1000
    found = ellipse_sink_m(radius_m, radius_m, rod_radius_m=0.0055, pitch_m=0.040)
    assert 1000 * found == pytest.approx(sink_mm, abs=0.05)
    reach_m = radius_m + 0.0055
    assert found == pytest.approx(reach_m - math.sqrt(reach_m**2 - 0.020**2), abs=1e-9)


def test_flat_belts_give_what_is_stated() -> None:
    for surface in ("flat", "cleats"):
        assert RestingLevel(surface, 0.004, 0.001).under(along_m=0.06, top_m=0.05) == (0.004, 0.001)


@pytest.mark.parametrize(("diameter_mm", "pitch_mm"), [(10.5, 32), (11, 40), (12, 36)])
def test_between_rods_tubers_lie_where_their_outline_says(diameter_mm: float, pitch_mm: float) -> None:
    """60 simulated tubers, each in a stable pose, lowered onto the web as whole meshes: rms 1.3 mm at most."""
    seed = 20
    rng = np.random.default_rng(seed)
    rods = Rods(diameter_mm / 2000, pitch_mm / 1000)
    support = Support(rods.pitch_m, rods.heights_m(0.00025))
    level = RestingLevel("rods", rod_pitch_m=rods.pitch_m, rod_diameter_m=2 * rods.radius_m)
    errors_m = []
    while len(errors_m) < 60:
        tuber = draw_tuber(rng, level=3)
        if tuber.axes_mm[1] < pitch_mm:
            continue
        heading = rotation_about(np.array([0.0, 0.0, 1.0]), rng.uniform(0, 2 * math.pi))
        body = rest_on_belt(tuber.vertices, heading @ resting_rotation(tuber.vertices, rng))
        _, z = settled(underside_of(body, tuber.faces), support, rng.uniform(0, rods.pitch_m))
        sink_m = -(z + float(body[:, 2].min()))
        found_m, _ = level.under(along_m=float(np.ptp(body[:, 0])), top_m=float(body[:, 2].max()) - sink_m)
        errors_m.append(found_m - sink_m)
    sys.stdout.write(f"seed {seed}: mean {1e3 * np.mean(errors_m):+.2f} mm, sd {1e3 * np.std(errors_m):.2f} mm\n")
    assert abs(np.mean(errors_m)) < 0.0004
    assert math.sqrt(float(np.mean(np.square(errors_m)))) < 0.0014


def test_a_view_takes_the_level_of_its_own_tuber() -> None:
    view = ellipsoid_view((0.042, 0.033, 0.028))
    flat = view.resting_on(RestingLevel("flat", 0.0055, 0.001))
    assert (flat.resting_offset_m, flat.resting_sd_m) == (0.0055, 0.001)
    web = RestingLevel("rods", 0.001, 0.001, 0.040, 0.011)
    lying = view.resting_on(web)
    # Belt x runs along the image's rows: the ellipsoid's second half axis.
    expected_m, sd_m = web.under(along_m=0.066, top_m=0.056)
    assert lying.resting_offset_m == pytest.approx(expected_m, abs=0.0006)
    assert lying.resting_sd_m == sd_m > 0.001
    small = ellipsoid_view((0.024, 0.022, 0.020)).resting_on(web)
    assert small.resting_offset_m > lying.resting_offset_m
    assert type(view).decode(lying.encode()).resting_offset_m == lying.resting_offset_m
    with pytest.raises(MessageError, match=r"resting_offset_m: .*got 0\.3"):
        view.resting_on(RestingLevel("flat", 0.3)).check()
    assert np.array_equal(view.belt_from_camera, straight_down_belt_from_camera(0.345))


def test_the_config_says_what_tubers_lie_on() -> None:
    config = parse_config(
        {"belt": {"surface": "rods", "rod_pitch_mm": 36, "rod_diameter_mm": 10.5, "resting_offset_mm": 1.5}}, where="t"
    )
    assert config.belt.resting_level == RestingLevel("rods", 0.0015, 0.0, 0.036, 0.0105)
    assert BeltConfig().resting_level == RestingLevel()
    with pytest.raises(ConfigError, match="farther apart"):
        parse_config({"belt": {"rod_pitch_mm": 20, "rod_diameter_mm": 25}}, where="t")
    with pytest.raises(ConfigError, match="resting_offset_mm"):
        parse_config({"belt": {"resting_offset_mm": 400}}, where="t")


def test_a_belt_whose_load_lies_on_its_plane_is_known_as_well_as_its_distance(tmp_path: Path) -> None:
    """Of `matched` too: its recordings had a resting level of their own, known to anything from 0.3 to 1.5 mm."""
    for preset, alike in (("easy", True), ("exact", True), ("matched", True), ("harsh", False)):
        simulate_views(out=tmp_path / preset, tubers=2, views=1, seed=5, preset=preset)
        views = list(read_labelled(tmp_path / preset))
        assert views
        assert all((view.level_sd_m == view.belt_sd_m) == alike for view in views), preset


def test_blanks_after_the_commas_of_a_table_and_capitals_change_nothing(tmp_path: Path) -> None:
    """' belt_distance_m' was another column than the one that is read: the season's distance was taken, and the level
    that the table stated was not.
    """
    write_twin(tmp_path, tubers=2, more={"resting_offset_mm": ["2", "2"], "resting_sd_mm": ["0.5", "0.5"]})
    table = tmp_path / "ground_truth.csv"
    plain = table.read_text(encoding="utf-8").replace("2026", "2023")  # whose own distance is another one
    read = []
    names, rows = plain.split("\n", 1)
    for text in (plain, plain.replace(",", ", "), f"{names.title()}\n{rows}"):
        table.write_text(text, encoding="utf-8")
        read.append([(v.belt_distance_m, v.resting_offset_m, v.weight_g, v.season) for v in read_labelled(tmp_path)])
    assert read[0] == read[1] == read[2]
    assert {view[:2] for view in read[1]} == {(0.42, 0.002)}
