"""Maps of fields with known patterns; a delay that was put into a real yield log is found again."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np
import pytest

from aggregator.yield_map.cells import cells_of, factors_to_one_scale
from aggregator.yield_map.delay import delays
from aggregator.yield_map.ground import harvest_in_order
from aggregator.yield_map.points import Crop, Machine, Points, Unused, cleaned, yield_points
from aggregator.yield_map.track import FieldPlane, Track, believed, plane_of
from camera_sim.sim.field import FieldWorld, MachineDay, simulate_field
from conveyor.errors import InputError

pytest.importorskip("pyproj")

WORLD = FieldWorld(size_m=(30.0, 90.0), scales=(1.0, 1.06), shown_share=0.5, outages=1)
SEED = 7301
INCH_M = 0.0254


def track_of(day: MachineDay) -> Track:
    return Track(day.time_ns, day.lat_deg, day.lon_deg, day.quality)


@pytest.fixture(scope="module")
def mapped() -> list[tuple[Points, Points]]:
    """(raw, cleaned) points of both machines of a field."""
    sys.stdout.write(f"seed {SEED}\n")
    found = []
    days = simulate_field(WORLD, seed=SEED).machines
    plane = plane_of(track_of(days[0]))
    for day in days:
        crop = Crop(day.crossed_ns / 1e9, day.kg_each, 0.08 * day.kg_each)
        points, lost_kg = yield_points(
            believed(track_of(day), plane), crop, Machine(WORLD.width_m, WORLD.delay_s, WORLD.overlap_m)
        )
        assert points.kg.sum() + lost_kg == pytest.approx(day.kg_each.sum()), "every kilogram is somewhere"
        found.append((points, cleaned(points)))
    return found


def test_cleaning_keeps_every_point_and_gives_each_left_out_a_reason(mapped: list[tuple[Points, Points]]) -> None:
    for raw, clean in mapped:
        assert (raw.kg == clean.kg).all()
        assert set(clean.unused) <= {str(reason) for reason in Unused}
        assert clean.reasons()[Unused.TURNING] > 30
        assert clean.reasons()[Unused.POSITION] == raw.reasons()[Unused.POSITION] > 0
        assert clean.used.sum() + sum(clean.reasons().values()) == len(clean.time_s)


def test_the_map_is_the_field(mapped: list[tuple[Points, Points]]) -> None:
    field = simulate_field(WORLD, seed=SEED)
    factors = factors_to_one_scale([clean for _, clean in mapped], width_m=WORLD.width_m)
    assert factors[0] / factors[1] == pytest.approx(1.06, rel=0.02)
    cells = cells_of([clean for _, clean in mapped], cell_m=10)
    plane = plane_of(track_of(field.machines[0]))
    corner = plane.to_metres(np.array([WORLD.origin_lat_deg]), np.array([WORLD.origin_lon_deg]))[0]
    truth, known = field.t_ha(cells.centres_m() - corner), np.isfinite(cells.t_ha)
    assert known.sum() >= 24
    assert np.corrcoef(truth[known], cells.t_ha[known])[0, 1] > 0.93
    assert cells.mean_t_ha == pytest.approx(truth[known].mean() * np.mean(WORLD.scales), rel=0.03)
    used_kg = sum(clean.kg[clean.used & (clean.ground.area_m2 > 0)].sum() for _, clean in mapped)
    assert cells.kg.sum() == pytest.approx(used_kg)


def test_ground_is_lifted_once() -> None:
    """Two strips of 3 m, the second half over the first: 1.5 m of it are new, and a third over both lifts nothing."""
    start = np.array([[0.0, 0.0], [1.5, 0.0], [0.75, 0.0]])
    end = start + np.array([0.0, 20.0])
    ground = harvest_in_order(start, end, width_m=3.0, known=np.ones(3, dtype=bool))
    assert ground.swept_m2 == pytest.approx([60, 60, 60])
    assert ground.area_m2 == pytest.approx([60, 30, 0], abs=2.0)
    assert len(np.unique(ground.square, axis=0)) == len(ground.square)


@pytest.mark.parametrize("at_m", np.linspace(0, 0.25, 6))
def test_rows_side_by_side_are_their_ground_wherever_they_lie(at_m: float) -> None:
    """Three squares of 0.25 m across a single row counted up to 6 % too little, by where the row lay."""
    x_m = np.repeat(at_m + 0.75 * np.arange(8), 40)
    start = np.stack([x_m, np.tile(0.3 * np.arange(40.0), 8)], axis=1)
    start[:, 0] += np.repeat(np.random.default_rng(3).normal(0, 0.03, 32), 10)
    lifted = harvest_in_order(start, start + np.array([0.0, 0.3]), width_m=0.75, known=np.ones(320, bool))
    assert 0.96 * lifted.swept_m2.sum() < lifted.area_m2.sum() <= lifted.swept_m2.sum()


def test_positions_that_cannot_be_are_left_out_and_counted() -> None:
    plane = FieldPlane(52.0, 5.0)
    lat, lon = plane.to_degrees(np.stack([np.zeros(8), np.arange(8) * 1.5], axis=1))
    lat[3] += 0.01  # a kilometre
    times = np.array([0, 1, 2, 3, 4, 4, 6, 60]) * 1_000_000_000
    quality = np.array([4, 4, 0, 4, 4, 4, 4, 4], dtype=np.uint8)
    path = believed(Track(times, lat, lon, quality), plane)
    assert path.faults == {
        "no fix": 1,
        "jumps farther than the machine can drive": 1,
        "time stands still or goes back": 1,
    }
    assert path.known(np.array([-1.0, 0.5, 3.0, 5.0, 30.0, 61.0])).tolist() == [False, True, True, True, False, False]
    with pytest.raises(InputError, match="no fix among them"):
        plane_of(Track(times, lat, lon, np.zeros(8, dtype=np.uint8)))


@pytest.mark.parametrize("wrong", [1, 5])
@pytest.mark.parametrize(("off_deg", "off_s"), [(0.5, 0), (0.0, 7200)])
def test_a_receivers_first_words_that_are_wrong_cost_no_others(wrong: int, off_deg: float, off_s: int) -> None:
    """One position where it was switched off, 55 km away, and of 700 good ones none was believed for 77 minutes."""
    plane = FieldPlane(52.0, 5.0)
    lat, lon = plane.to_degrees(np.stack([np.zeros(700), np.arange(700) * 1.5], axis=1))
    times = np.arange(700) * 1_000_000_000
    lat[:wrong] += off_deg
    times[:wrong] += off_s * 1_000_000_000
    path = believed(Track(times, lat, lon, np.full(700, 4, dtype=np.uint8)), plane)
    assert path.time_s.tolist() == list(range(wrong, 700))
    assert sum(path.faults.values()) == wrong, path.faults


def test_who_is_elsewhere_after_an_outage_is_believed_again_and_before_it_too() -> None:
    """Some good positions that follow each other elsewhere are no reason to doubt the more that came before."""
    plane = FieldPlane(52.0, 5.0)
    north_m = np.r_[np.arange(300) * 1.5, 12_000 + np.arange(1200) * 1.5]
    lat, lon = plane.to_degrees(np.stack([np.zeros(1500), north_m], axis=1))
    times = np.r_[np.arange(300), 1200 + np.arange(1200)] * 1_000_000_000
    path = believed(Track(times, lat, lon, np.full(1500, 4, dtype=np.uint8)), plane)
    assert path.faults.get("jumps farther than the machine can drive", 0) < 150
    assert path.time_s[0] == 0
    assert path.time_s[-1] == 2399


def test_a_field_on_the_180th_meridian_has_its_size() -> None:
    """The middle of its longitudes lay at Greenwich, and the field came out three times as wide."""
    lon = np.array([179.9998, 179.9999, -179.9999, -179.9998])
    track = Track(np.arange(4) * 10**10, np.full(4, -16.8), lon, np.full(4, 4, dtype=np.uint8))
    plane = plane_of(track)
    assert np.ptp(plane.to_metres(track.lat_deg, lon)[:, 0]) == pytest.approx(0.0004 * 106_600, rel=0.01)


def test_a_delay_put_into_a_real_log_is_found_within_a_second(shared: Path) -> None:
    """By opposite passes and by starts and stops, each for itself; the two agree on the log as it is."""
    path, crop = real_log(shared)
    log = delays(path, crop, width_m=360 * INCH_M)
    assert abs(log[0].delay_s - log[1].delay_s) < 2, log
    for injected_s in (9.0, 24.0):
        late = Crop(crop.time_s + injected_s, crop.kg, crop.sd_kg)
        found = delays(path, late, width_m=360 * INCH_M)
        assert [delay.by for delay in found] == [delay.by for delay in log]
        for before, after in zip(log, found, strict=True):
            assert after.delay_s - before.delay_s == pytest.approx(injected_s, abs=1.0), after


def real_log(shared: Path):  # type: ignore[no-untyped-def]
    """A combine's path, and its crop as one reading every three seconds."""
    with (shared / "data" / "yield_log" / "gartner.corn.csv").open() as file:
        rows = list(csv.DictReader(file))
    time_s, mass, seconds, lat, lon = (
        np.array([float(row[name]) for row in rows]) for name in ("time", "mass", "seconds", "lat", "long")
    )
    track = Track((time_s * 1e9).astype(np.int64), lat, lon, np.ones(len(rows), dtype=np.uint8))
    kg = mass * seconds * 0.4536
    return believed(track, plane_of(track)), Crop(time_s, kg, 0.1 * kg)
