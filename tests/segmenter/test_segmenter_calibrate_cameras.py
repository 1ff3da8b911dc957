"""`tuberline calibrate cameras`: what it measures, what it prints, and that a line counts by it."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hung_cameras import PLACES, belt, record

import tuberline
from conveyor.camera_place import CameraPlace
from conveyor.config import load_config
from conveyor.errors import InputError
from conveyor.formats import open_source
from tests.belts import replay
from tuberline.cli.calibrate_cameras import calibrate_cameras
from tuberline.places import belt_in, places_in

SEED = 31


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hung") / "belt"
    record(folder, belt(SEED))
    return folder


def beside(told: dict[str, CameraPlace]) -> tuple[float, float, float]:
    """Of the right camera against the left one: along, across, turned."""
    left, right = told["left"], told["right"]
    turned_deg = (right.turned_deg - left.turned_deg + 180) % 360 - 180
    return right.along_m - left.along_m, right.across_m - left.across_m, turned_deg


def test_two_cameras_are_placed_and_a_line_counts_by_it(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibrate_cameras(recording, across_m=-0.22)
    out, err = capsys.readouterr()
    assert "tubers that both see" in err
    assert "which it sees higher" in err
    file = tmp_path / "places.toml"
    file.write_text(out, encoding="utf-8")
    sections = load_config(file).cameras
    places = {name: section.place for name, section in sections.items() if section.place is not None}
    assert places["left"].across_m == -0.22
    along_m, across_m, turned_deg = beside(places)
    true = beside(PLACES)
    assert (along_m, across_m) == pytest.approx(true[:2], abs=0.003)
    assert abs(turned_deg - true[2]) < 0.6
    assert sections["right"].belt_distance_m == pytest.approx(0.46, abs=0.0005)

    summary = replay(recording, tmp_path / "run", "--places", str(file), "--fast", "--regressors", "1")
    seen = sum(abs(body.y_m + 0.22) < 0.4 or abs(body.y_m - 0.25) < 0.4 for body in belt(SEED))
    assert summary["totals"]["count"] == seen == len(belt(SEED))
    (apart,) = summary["totals"]["apart"]
    assert (apart["twice"], apart["alarm"]) == (0, False)
    assert summary["tubers"]["merged"] >= apart["shared"] >= 10
    totals = tuberline.read_ledger(tmp_path / "run").totals
    assert totals is not None
    assert asdict(totals.apart[0]) == apart


def test_its_json_has_the_pose(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    calibrate_cameras(recording, json=True)
    left, right = json.loads(capsys.readouterr().out)
    assert (left["camera"], left["placed"], left["beside"], left["across_m"]) == ("left", True, "", 0.0)
    assert (right["camera"], right["beside"]) == ("right", "left")
    assert right["shared"] >= 10
    pose = np.array(right["belt_from_camera"])
    assert CameraPlace.of(pose).across_m == pytest.approx(right["across_m"])
    assert pose[2] == pytest.approx([0, 0, -1, 0.46], abs=0.004)


def test_without_an_encoder_the_clocks_lay_the_cameras_side_by_side(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "belt", belt(SEED + 1), encoder=False)
    calibrate_cameras(tmp_path / "belt", json=True)
    left, right = json.loads(capsys.readouterr().out)
    true = beside(PLACES)

    assert right["along_m"] - left["along_m"] == pytest.approx(true[0], abs=0.004)
    assert right["across_m"] - left["across_m"] == pytest.approx(true[1], abs=0.004)


def test_cameras_that_share_no_tubers_are_told_and_the_others_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    apart = {"left": CameraPlace(0.0, -0.7), "right": CameraPlace(0.0, 0.7)}
    record(tmp_path / "belt", belt(SEED + 2, half_width_m=1.1), places=apart)
    with pytest.raises(InputError, match="camera right shares too few tubers with the others") as refused:
        calibrate_cameras(tmp_path / "belt")
    assert refused.value.exit_code == 2
    out = capsys.readouterr().out
    assert "[cameras.left]" in out
    assert "[cameras.right]" not in out


def test_a_bare_belt_says_nothing_of_its_direction(tmp_path: Path) -> None:
    record(tmp_path / "belt", [], places={"left": CameraPlace()})
    with pytest.raises(InputError, match="too little to say which way the belt runs; record the belt while it carries"):
        calibrate_cameras(tmp_path / "belt")


def test_places_of_a_file_reach_the_frames_and_leave_what_they_do_not_say(recording: Path, tmp_path: Path) -> None:
    file = tmp_path / "line.toml"
    file.write_text("[cameras.left]\nbelt_distance_m = 0.5\nacross_m = 0.1\nturned_deg = 90.0\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"says nothing of camera right: its section \[cameras.right\] needs"):
        places_in(file, ["left", "right"])
    (said,) = places_in(file, ["left"]).values()
    assert said == {"belt_distance_m": 0.5, "across_m": 0.1, "turned_deg": 90.0}
    assert belt_in(file) == {}
    (web := tmp_path / "web.toml").write_text(file.read_text() + '[belt]\nsurface = "rods"\n', encoding="utf-8")
    assert belt_in(web) == {"surface": "rods"}
    (gauge := tmp_path / "gauge.toml").write_text('[belt]\ngauge = "travel"\n', encoding="utf-8")
    assert places_in(gauge, ["left", "right"]) == {}
    place = load_config(file).camera("left").place
    plain = next(iter(open_source(recording, camera="left").frames(run="r")))
    turned = open_source(recording, camera="left", belt_distance_m=0.5, place=place)
    frame = next(iter(turned.frames(run="r")))
    assert frame.depth.shape == plain.depth.shape[::-1], "a belt across the image is turned to run down it"
    assert frame.belt_from_camera is not None
    assert frame.belt_from_camera[0, 1] == pytest.approx(1.0)
    assert frame.belt_from_camera[:3, 3] == pytest.approx([0.0, 0.1, 0.5])
