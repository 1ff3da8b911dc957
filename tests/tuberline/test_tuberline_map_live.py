"""The map of a run that goes on, as the page gets it, and as a browser draws it."""

from __future__ import annotations

import json
import math
import shutil
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aggregator.ledger.writer import Ledger
from aggregator.yield_map.no_map import NoMapError
from camera_sim.sim.field import FieldWorld, simulate_field
from conveyor import topics
from conveyor.config import parse_config
from conveyor.delivery import KeptPublisher, LatestPublisher, ReliablePublisher
from conveyor.formats.positions import POSITIONS_FILE, PositionsWriter, read_positions
from conveyor.messages import Position
from tests.deploy.remote_browser import Browser, chromium
from tests.viewer import viewer_line as line
from tests.viewer.page_states import loaded_state
from tests.viewer.test_viewer_page_browser import js, text, until
from tests.viewer.test_viewer_page_server import ask
from tests.written_run import write_run
from tuberline.export.cells import cells_table
from tuberline.maps.field import Settings, field_map
from tuberline.maps.live import LiveMap, features, live_map, newest_run
from viewer.page.board import Board
from viewer.page.maps import FieldMaps
from viewer.page.server import PageServer
from viewer.page.snapshot import snapshot
from viewer.scene.field_scene import FieldScene
from viewer.scene.primitives import Moment, YieldCells
from viewer.way import AGREEING, MOST_PLACES, Way

pytest.importorskip("pyproj")
WORLD = FieldWorld(size_m=(24.0, 80.0), shown_share=0.1)
SEED = 7303
SETTINGS = Settings(3.0, overlap_m=0.1, delay_s=WORLD.delay_s)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One machine's run of a simulated field with its own positions, beside an older run of the same ledger."""
    sys.stdout.write(f"seed {SEED}\n")
    out = tmp_path_factory.mktemp("field") / "run"
    (day,) = simulate_field(replace(WORLD, scales=(1.0,)), seed=SEED).machines
    write_run(out, run="today", crossed_ns=day.crossed_ns, weight_g=day.kg_each * 1000)
    with PositionsWriter(out / POSITIONS_FILE) as file:
        for time_ns, lat, lon, quality in zip(day.time_ns, day.lat_deg, day.lon_deg, day.quality, strict=True):
            file.write((int(time_ns), int(time_ns), float(lat), float(lon), int(quality), 0.8, 12))
    return out


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """One that draws maps."""
    with chromium(tmp_path_factory.mktemp("browser") / "profile") as running:
        yield running


def test_the_live_map_is_the_map_of_its_run(run: Path) -> None:
    found = live_map(run, SETTINGS, newest_run(run))
    assert found.cells.mean_t_ha == field_map([run], [], SETTINGS).cells.mean_t_ha
    cells, about = features(found)
    assert len(cells) == int(np.isfinite(found.cells.t_ha).sum())
    assert about["low"] <= about["mean"] <= about["high"]
    lons, lats = np.array([cell["geometry"]["coordinates"][0] for cell in cells]).reshape(-1, 2).T
    east_m = (lons.max() - lons.min()) * np.cos(np.radians(lats.mean())) * 111_320
    assert east_m <= WORLD.size_m[0] + 3 * found.cells.cell_m, "degrees, longitude first"
    live_map(run, replace(SETTINGS, delay_s=None), newest_run(run))  # not found yet: then it is assumed


def test_a_field_on_the_180th_meridian_is_drawn_in_one_piece(run: Path, tmp_path: Path) -> None:
    """Cells went around the Earth, Rerun had them at Greenwich, and the way lost four places at each crossing."""
    shutil.copy(run / "ledger.db", tmp_path)
    day, way = read_positions(run / POSITIONS_FILE), Way()
    middle_deg = float(np.quantile([p.lon_deg for p in day], 0.4))
    with PositionsWriter(tmp_path / POSITIONS_FILE) as file:
        for p in day:
            lon_deg = (p.lon_deg - middle_deg) % 360 - 180
            file.write((p.time_ns, p.time_ns, p.lat_deg, lon_deg, p.quality, p.hdop, p.satellites))
            way.add(lat_deg=p.lat_deg, lon_deg=lon_deg)
    before, found = (live_map(folder, SETTINGS, newest_run(folder)) for folder in (run, tmp_path))
    widths = [np.ptp(it.squares()[..., 0], axis=1) for it in (before, found)]
    assert widths[1] == pytest.approx(widths[0], rel=0.01)
    assert np.ptp(found.squares()[..., 0]) == pytest.approx(np.ptp(before.squares()[..., 0]), rel=0.01)
    areas = cells_table([tmp_path], found).polygons
    assert areas is not None
    assert {len(parts) for parts in areas} == {1, 2}
    assert all(-180 <= lon <= 180 for parts in areas for ring in parts for lon, _ in ring)
    plain = Way()
    for p in day:
        plain.add(lat_deg=p.lat_deg, lon_deg=p.lon_deg)
    assert len(way.lon_lat) == len(plain.lon_lat)
    cells, about = features(found)
    (drawn, _) = FieldScene().on_cells(cells, about, Moment(0, 0))
    assert isinstance(drawn.primitive, YieldCells)
    assert np.all(180 - np.abs(drawn.primitive.lat_lon_deg[:, 1]) < 0.001)


def why_none(folder: Path) -> str:
    with pytest.raises(NoMapError) as caught:
        live_map(folder, SETTINGS, newest_run(folder))
    return caught.value.why


def test_why_there_is_no_map_is_told_by_what_is_missing(run: Path, tmp_path: Path) -> None:
    """The page showed the machine's way, or nothing, whatever was missing."""
    told: list[tuple[str, str]] = []
    config = parse_config({"aggregator": {"out": str(tmp_path)}, "gnss": {"source": "file:x"}}, where="test")
    keeping = LiveMap(config, lambda *_: None, lambda *why: told.append(why))
    keeping.start()
    until(lambda: told, what="why there is no map")
    keeping.stop()
    assert told == [("no_ledger", f"{tmp_path} holds no ledger with a run")]
    unreadable = tmp_path / ("long" * 100)
    config = parse_config({"aggregator": {"out": str(unreadable)}, "gnss": {"source": "file:x"}}, where="test")
    keeping = LiveMap(config, lambda *_: None, lambda *why: told.append(why))
    keeping.start()
    until(lambda: len(told) > 1, what="what the disk says, which ended the map without a word")
    assert "map" in [thread.name for thread in threading.enumerate()], "it is tried again"
    keeping.stop()
    assert told[1] == ("", f"{unreadable / 'ledger.db'}: File name too long")
    with Ledger(tmp_path / "ledger.db") as ledger:
        ledger.open_run("empty", line="line", cameras=("left",), version="1", started_ns=0)
    assert why_none(tmp_path) == "no_positions"
    shutil.copy(run / POSITIONS_FILE, tmp_path)
    assert why_none(tmp_path) == "no_tubers"
    day = read_positions(run / POSITIONS_FILE)
    for why, changed in (
        ("no_fix", {"quality": 0}),
        ("no_ground", {"lat_deg": day[0].lat_deg, "lon_deg": day[0].lon_deg}),
        ("other_times", {"time_ns": 86_400_000_000_000}),
    ):
        folder = tmp_path / why
        folder.mkdir()
        shutil.copy(run / "ledger.db", folder)
        with PositionsWriter(folder / POSITIONS_FILE) as file:
            for n, place in enumerate(day[:300]):
                moved = replace(place, **changed)
                time_ns = place.time_ns + changed.get("time_ns", 0)
                file.write((time_ns, n, moved.lat_deg, moved.lon_deg, moved.quality, 0.8, 12))
        assert why_none(folder) == why


@pytest.mark.graph
def test_a_viewer_draws_the_field_while_the_machine_drives(run: Path, tmp_path: Path) -> None:
    """Positions over the line, cells from the ledger beside it: both are in Rerun's file."""
    pytest.importorskip("rerun")
    rrd, found, day = (
        tmp_path / "load.rrd",
        live_map(run, SETTINGS, newest_run(run)),
        read_positions(run / POSITIONS_FILE),
    )
    more = (
        f'[aggregator]\nout = "{run}"\n[gnss]\nsource = "file:x.nmea"\nwidth_m = 3.0\noverlap_m = 0.1\n'
        f"delay_s = {WORLD.delay_s}\n"
    )
    with line.router() as link, line.viewer(link, tmp_path, "--rrd", str(rrd), more=more) as watcher:
        info = KeptPublisher(watcher.observer, topics.CAMERA_INFO, camera="front")
        frames = LatestPublisher(watcher.observer, topics.FRAME_FEW, camera="front")
        told = ReliablePublisher(watcher.observer, topics.POSITION, receiver="roof")
        info.put(line.camera_info())
        line.within(10, lambda: frames.has_listener, "the viewer subscribes to frames")
        frames.put(line.frame(0, line.potatoes(1, seed=1)))
        for n, place in enumerate(day[:200]):
            told.put(
                Position("roof", line.RUN, n, place.time_ns, place.time_ns, place.lat_deg, place.lon_deg, 4, 0.8, 9)
            )
        line.within(10, lambda: watcher.counter("position_shown") >= 60, "positions are shown")
        line.within(60, lambda: watcher.counter("cells_shown") >= 1, "the yield is shown")
        line.within(10, lambda: watcher.settled("file"), "the file has everything")
        watcher.stop()
    known = np.isfinite(found.cells.t_ha)
    ((_, t_ha),) = line.column(rrd, "/field/cells", "t_ha")[-1:]
    assert sorted(t_ha) == pytest.approx(sorted(found.cells.t_ha[known]), abs=0.05)
    ((_, centres),) = line.column(rrd, "/field/cells", "GeoPoints:positions")[-1:]
    lat, lon = found.plane.to_degrees(found.cells.centres_m()[known])
    assert np.allclose(np.array(centres), np.stack([lat, lon], axis=1), atol=2e-7)
    here = [value[0] for _, value in line.column(rrd, "/field/machine", "GeoPoints:positions")]
    assert all(any(math.dist(place, (p.lat_deg, p.lon_deg)) < 1e-9 for p in day[:200]) for place in here)
    assert len(here) > 10, "the machine's places"
    assert len(line.column(rrd, "/field/way", "GeoLineStrings:line_strings")) >= 1
    assert "t/ha" in line.column(rrd, "/field/page", "TextDocument:text")[-1][1][0]


def test_a_way_is_bounded_and_told_now_and_then() -> None:
    maps = FieldMaps()
    assert json.loads(maps.newest("north"))["number"] == maps.number("north") == 0
    for n in range(3 * MOST_PLACES):
        maps.add_place("north", lat_deg=52.0 + n * 2e-5, lon_deg=5.0)
        maps.add_place("north", lat_deg=52.0 + n * 2e-5 + 1e-7, lon_deg=5.0)
    found = json.loads(maps.newest("north"))
    assert len(found["way"]) <= MOST_PLACES + 1
    assert found["way"][0] == [5.0, 52.0]
    assert found["way"][-1] == pytest.approx([5.0, 52.0 + (3 * MOST_PLACES - 1) * 2e-5])
    assert 0 < found["number"] < MOST_PLACES


def test_a_wild_place_is_not_drawn_and_a_long_gap_is() -> None:
    """A receiver's single places 100 m off made spikes, and the field a fifth of the map."""
    way, step_deg = Way(), 2e-5
    places = [(52.0 + n * step_deg, 5.0) for n in range(10)]
    wild = [(52.001, 5.002), (51.998, 4.998)]
    for lat_deg, lon_deg in (*places[:5], *wild, *places[5:]):
        way.add(lat_deg=lat_deg, lon_deg=lon_deg)
    assert way.lon_lat == [(lon, lat) for lat, lon in places]
    after = [(52.01 + n * step_deg, 5.0) for n in range(10)]
    added = [way.add(lat_deg=lat_deg, lon_deg=lon_deg) for lat_deg, lon_deg in after]
    assert added == [False] * (AGREEING - 1) + [True] * (11 - AGREEING), "where it is after an hour without a fix"


@pytest.mark.graph
def test_a_browser_draws_the_field_without_anything_from_elsewhere(run: Path, browser: Browser) -> None:
    found = live_map(run, SETTINGS, newest_run(run))
    cells, about = features(found)
    board, maps = Board(["north"]), FieldMaps()
    with PageServer(board, host="127.0.0.1", port=0, maps=maps) as page:
        assert json.loads(ask(page, "/map.json?line=south")[2])["cells"]["features"] == []
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")

        def told() -> None:
            board.put({**snapshot(loaded_state()), "looks_only": "", "map": maps.number("north")})

        until(lambda: told() or "Load 3" in text(browser), what="the page")
        assert js(browser, "document.querySelector('.field').hidden"), "no field, no map, and no megabyte to load"
        maps.no_fix("north")
        until(lambda: told() or "No yields: the GNSS receiver has no fix." in text(browser), what="why there is none")
        maps.tell_why("north", "", "track x holds no position")
        maps.add_place("north", lat_deg=52.0, lon_deg=5.0)
        maps.tell_why("north", "no_ground", "no cell of 10 m")
        until(lambda: told() or "No yields: too little ground is lifted yet" in text(browser), what="another reason")
        assert js(browser, "document.querySelector('.map').hidden")
        assert not js(browser, "'maplibregl' in window")
        maps.begin("north")
        maps.put_cells("north", cells, about)
        first = cells[0]["geometry"]["coordinates"][0][0]
        for n in range(30):
            maps.add_place("north", lat_deg=first[1] + n * 2e-5, lon_deg=first[0])
        drawn = "Number(document.querySelector('.map').dataset.cells || 0)"
        until(lambda: told() or js(browser, drawn) >= len(cells), what="the cells on the map")
        assert f"t/ha, mean {about['mean']:.1f}" in text(browser)
        js(browser, IN_POUNDS)
        mean = f"{about['mean'] * 1000 / 0.45359237 / 2.4710538:,.0f}".replace(",", " ")
        of_acre = f"lb/acre, mean {mean}"
        until(lambda: told() or of_acre in text(browser), what="the legend in the unit of the page")
        assert "lb/acre" in js(browser, "document.querySelector('.map').getAttribute('aria-label')")
        js(browser, "localStorage.clear()")
        maps.begin("north")
        until(lambda: told() or js(browser, "document.querySelector('.field').hidden"), what="the next run's field")
        for n in range(2):
            maps.add_place("north", lat_deg=first[1] + n * 2e-5, lon_deg=first[0])
        until(lambda: told() or "The machine's way so far." in text(browser), what="its way")
        js(browser, BESIDE)
        until(lambda: js(browser, "window.beside") == [180.0001, 180], what="a field on the 180th meridian")
        assert "No yields" not in text(browser), "no cells were computed yet, so nothing is known to be missing"
        until(lambda: told() or js(browser, drawn) == 0, what="no cells of the run before")


IN_POUNDS = """Object.assign(document.getElementById('unit'), {value: 'lb'}).dispatchEvent(new Event('change'))"""
BESIDE = """import("./map.js").then(({ inOnePiece }) => {
    const square = { geometry: { coordinates: [[[-179.9999, 1]]] } };
    const found = inOnePiece({ way: [[179.9999, 1], [-180, 1]], cells: { features: [square] } });
    window.beside = [found.cells.features[0].geometry.coordinates[0][0][0], found.way[1][0]]; })"""
LOSE_THE_MAP = """{ const whole = window.fetch; let left = 2; window.fetch = (...asked) => {
    if (!left || !String(asked[0]).startsWith("map.json")) return whole(...asked);
    left -= 1;
    return Promise.reject(new TypeError("no network")); }; }"""
NO_WEBGL = "HTMLCanvasElement.prototype.getContext = () => null"


@pytest.mark.graph
@pytest.mark.parametrize("broken", [LOSE_THE_MAP, NO_WEBGL], ids=["network", "webgl"])
def test_why_there_is_no_map_is_told_as_it_is(broken: str, browser: Browser) -> None:
    """A network that failed once was told as a browser without WebGL; one without had a legend below no map."""
    board, maps = Board(["north"]), FieldMaps()
    with PageServer(board, host="127.0.0.1", port=0, maps=maps) as page:
        browser.page("Page.navigate", url=f"http://127.0.0.1:{page.port}/")

        def told() -> str:
            board.put({**snapshot(loaded_state()), "looks_only": "", "map": maps.number("north")})
            return text(browser)

        until(lambda: "Load 3" in told(), what="the page")
        js(browser, broken)
        for n in range(2):
            maps.add_place("north", lat_deg=52.0 + n * 2e-5, lon_deg=5.0)
        wanted, wrong = "The machine's way so far. No yields: the page was started", "This browser cannot draw the map"
        if broken == NO_WEBGL:
            wanted, wrong = wrong, "The machine's way"
        until(lambda: wanted in told(), what=wanted)
        for _ in range(5):
            assert wrong not in told()
