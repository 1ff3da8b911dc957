"""`tuberline map` on ledgers of a simulated field: the picture, the numbers, and what it says when it cannot."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from camera_sim.sim.field import FieldWorld, simulate_field
from conveyor.errors import InputError
from tests.written_run import write_run
from tuberline.cli.map import map_field
from tuberline.maps.field import Settings, field_map
from tuberline.maps.settings import OF_MACHINE, settings_of

pytest.importorskip("pyproj")
pytest.importorskip("matplotlib")

WORLD = FieldWorld(size_m=(24.0, 80.0), scales=(1.0, 1.08), shown_share=0.1, outages=1, stop_every_s=60, stop_s=15)
SEED = 7302


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two machines' runs of one field, each with its track as positions of another maker's file."""
    sys.stdout.write(f"seed {SEED}\n")
    folder = tmp_path_factory.mktemp("field")
    for number, day in enumerate(simulate_field(WORLD, seed=SEED).machines):
        run = folder / f"machine-{number}"
        write_run(run, run=run.name, crossed_ns=day.crossed_ns, weight_g=day.kg_each * 1000)
        rows = zip(day.time_ns / 1e9, day.lat_deg, day.lon_deg, day.quality, strict=True)
        lines = [
            "time_s,latitude,longitude,quality",
            *(",".join(map(repr, map(float, row[:3]))) + f",{row[3]}" for row in rows),
        ]
        (run / "track.csv").write_text("\n".join(lines) + "\n")
    return sorted(folder.iterdir())


def test_two_machines_make_one_map(runs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tracks = [run / "track.csv" for run in runs]
    out = tmp_path / "map.png"
    title = r"Field $\bad$ 5"  # it was set as a formula, and this one is none
    map_field(runs, track=tracks, width_m=3.0, overlap_m=0.1, cell_m=8.0, out=out, title=title, json=True)
    told = json.loads(capsys.readouterr().out)
    assert told["mean_t_ha"] == pytest.approx(
        sum(cell["kg"] for cell in told["cells"]) / sum(c["area_m2"] for c in told["cells"]) * 10
    )
    first, second = told["runs"]
    assert first["factor"] / second["factor"] == pytest.approx(1.08, rel=0.08), "a tenth of the tubers are weighed"
    for run in told["runs"]:
        assert run["delay_s"] == pytest.approx(WORLD.delay_s, abs=2.5)
        assert run["points_unused"]["turning"] > 0
    assert all(cell["low_t_ha"] <= cell["t_ha"] <= cell["high_t_ha"] for cell in told["cells"])
    picture = cv2.imread(str(out))
    assert picture is not None
    assert np.std(picture) > 10, "something is drawn"


def test_positions_of_another_year_are_counted(
    runs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They were left out without a word."""
    head, *rows = (runs[0] / "track.csv").read_text().splitlines()
    at, _, rest = rows[0].partition(",")
    (tmp_path / "track.csv").write_text("\n".join([head, f"{float(at) + 3e8},{rest}", *rows]) + "\n")
    map_field([runs[0]], track=[tmp_path / "track.csv"], width_m=3.0, delay_s=17.0, out=tmp_path / "map.png", json=True)
    assert json.loads(capsys.readouterr().out)["runs"][0]["positions_unused"]["more than a day from any tuber"] == 1


def test_a_machine_that_stands_is_told_as_that(runs: list[Path], tmp_path: Path) -> None:
    """It said that no point can be used, and not why."""
    head, *rows = (runs[0] / "track.csv").read_text().splitlines()
    stood = [f"{row.partition(',')[0]},52.7,5.75,4" for row in rows]
    (tmp_path / "track.csv").write_text("\n".join([head, *stood]) + "\n")
    with pytest.raises(InputError, match=r"none of the \d+ seconds of the track can be used \(\d+ standing\)"):
        map_field([runs[0]], track=[tmp_path / "track.csv"], width_m=3.0, delay_s=17.0)


def test_the_command_as_typed(runs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "[red]map[2].rrd"
    arguments = ["map", runs[0], "--track", runs[0] / "track.csv", "--width-m", "3", "--out", out]
    done = subprocess.run([sys.executable, "-m", "tuberline", *arguments], capture_output=True, text=True, check=True)
    assert "t/ha" in done.stdout
    assert "seconds used" in done.stdout
    assert f"map: {out}\n" in done.stdout, "brackets were markup, a long path was cut"
    assert out.stat().st_size > 1000


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({}, "a map needs the working width"),
        ({"width_m": 3}, "has no positions.csv"),
        ({"width_m": 3, "track": 2}, "give one --track for each run"),
        ({"width_m": 0.05, "track": 1}, "working width is 0.05 m; allowed are 0.2 to 50 m"),
        ({"width_m": 3, "track": 1, "track_shift_s": 90000}, "another day's track"),
        ({"width_m": 3, "track": 1, "delay_s": 9000}, "allowed are -60 to 600 s"),
        ({"width_m": 3, "track": 1, "cell_m": 0.1}, "allowed are 1 to 1000 m"),
        ({"width_m": 3, "track": 1, "antenna_ahead_m": 300}, "the antenna is 300 m in front .* allowed are -20 to 20"),
        ({"width_m": 3, "track": 1, "delay_s": 17, "cell_m": 1000}, "no cell of 1000 m has a quarter"),
    ],
)
def test_what_cannot_be_mapped_is_one_sentence(
    runs: list[Path], given: dict[str, Any], told: str, tmp_path: Path
) -> None:
    track = [runs[0] / "track.csv"] * given.pop("track", 0)
    with pytest.raises(InputError, match=told):
        map_field([runs[0]], track=track, **given, out=tmp_path / "map.png")
    assert not (tmp_path / "map.png").exists()


def test_a_picture_of_another_kind_is_refused_before_the_work(runs: list[Path], tmp_path: Path) -> None:
    """It was matplotlib's ValueError when the map was made, and `--out` named like the track replaced that."""
    track = tmp_path / "track.png"
    track.write_bytes((runs[0] / "track.csv").read_bytes())
    for name, told in (("map.bmp", r"written as \.png, \.svg, \.pdf, \.jpg"), ("track.png", "is read by this very")):
        with pytest.raises(InputError, match=told):
            map_field([runs[0]], track=[track], width_m=3.0, out=tmp_path / name)
    with pytest.raises(InputError, match="are one run, and two tracks are given"):
        map_field([runs[0], runs[0] / "ledger.db"], track=[track, runs[0] / "track.csv"], width_m=3.0)
    assert list(tmp_path.iterdir()) == [track]


def test_two_fields_far_apart_are_told(runs: list[Path], tmp_path: Path) -> None:
    """Their map took 116 GiB, and with them the process that made it."""
    head, *lines = (runs[1] / "track.csv").read_text().splitlines()
    rows = (line.split(",") for line in lines)
    moved = [f"{at},{float(lat) + 1.2},{float(lon) + 1},{fix}" for at, lat, lon, fix in rows]
    (tmp_path / "far.csv").write_text("\n".join([head, *moved]) + "\n")
    with pytest.raises(InputError, match=r"spans .* by 13\d\.\d km, \d+ cells of 10 m; a map has up to 4000000"):
        map_field(runs, track=[runs[0] / "track.csv", tmp_path / "far.csv"], width_m=3.0, delay_s=17.0)


def test_a_clock_that_was_set_between_two_runs_takes_no_memory(runs: list[Path], tmp_path: Path) -> None:
    """A machine without a clock of its own began in 1970: its map had a second for each since then, 13 GiB."""
    folder, both = tmp_path / "run", tmp_path / "both.csv"
    shutil.copytree(runs[0], folder)
    crossed_ns = 60_000_000_000 + np.arange(20) * 10**9
    write_run(folder, run="booted", crossed_ns=crossed_ns, weight_g=np.full(20, 170.0))
    whole = field_map([runs[0]], [runs[0] / "track.csv"], Settings(3.0))
    found = field_map([folder], [folder / "track.csv"], Settings(3.0))
    assert found.shares[0].delay == whole.shares[0].delay
    assert found.shares[0].lost_kg == pytest.approx(whole.shares[0].lost_kg + 20 * 0.170)
    head, *rows = (folder / "track.csv").read_text().splitlines()
    both.write_text("\n".join([head, *(f"{n},{rows[0].split(',', 1)[1]}" for n in range(60, 90)), *rows]) + "\n")
    assert field_map([runs[0]], [both], Settings(3.0)).cells.mean_t_ha == whole.cells.mean_t_ha
    with pytest.raises(InputError, match=r"spans 1970-01-01 .* to 2026.*, and so do tubers: a clock was set since"):
        field_map([folder], [both], Settings(3.0))


def test_each_machine_has_its_own_width(runs: list[Path], tmp_path: Path) -> None:
    """Of a machine of two rows and one of four all ground was as wide as the first one's."""
    folders, tracks = [tmp_path / run.name for run in runs], [run / "track.csv" for run in runs]
    for folder, run, width_m in zip(folders, runs, (1.5, 3.0), strict=True):
        folder.mkdir()
        (folder / "ledger.db").symlink_to(run / "ledger.db")
        (folder / "line.toml").write_text(f'[gnss]\nsource = "file:x"\nwidth_m = {width_m}\ndelay_s = 17.0\n')
    given = dict.fromkeys(OF_MACHINE)
    both = field_map(folders, tracks, settings_of(folders, **given)).shares
    alike = field_map(runs, tracks, Settings(3.0, delay_s=17.0)).shares
    assert [share.width_m for share in both] == [1.5, 3.0]
    assert both[0].points.ground.swept_m2.sum() == pytest.approx(alike[0].points.ground.swept_m2.sum() / 2)
    assert both[1].points.area_m2.sum() == alike[1].points.area_m2.sum()
    wide = settings_of(folders, **given | {"width_m": 2.0})
    assert [(each.width_m, each.delay_s) for each in wide] == [(2.0, 17.0), (2.0, 17.0)]
