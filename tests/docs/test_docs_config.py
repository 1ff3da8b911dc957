"""Every key of a line's file is described, and the page and the command say of it what the schema checks."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib

import pytest

from conveyor.config import CameraConfig, LineConfig, SegmenterConfig, parse_config
from conveyor.config_realsense import RealSenseConfig
from conveyor.errors import ConfigError
from tuberline.cli.config_page import CAMERA, config_page, explained, settings


def test_every_key_is_there_with_its_meaning() -> None:
    keys = {setting.key for setting in settings()}
    assert {f"cameras.{CAMERA}.{name}" for name in CameraConfig.model_fields if name != "realsense"} <= keys
    assert {f"cameras.{CAMERA}.realsense.{name}" for name in RealSenseConfig.model_fields} <= keys
    assert {f"segmenter.{name}" for name in SegmenterConfig.model_fields} <= keys
    sections = {name for name in LineConfig.model_fields if name != "name"}
    assert {key.partition(".")[0] for key in keys} == sections | {"name"}
    assert [setting.key for setting in settings() if not setting.meaning] == [], "give it a description"


def test_a_row_says_what_is_checked() -> None:
    ring = explained("segmenter.ring")
    assert (ring.type, ring.default, ring.range, ring.unit) == ("whole number", "`6`", "from 1 to 64", "frames")
    for value, fine in ((0, False), (1, True), (64, True), (65, False)):
        if fine:
            parse_config({"segmenter": {"ring": value}}, where="test")
        else:
            with pytest.raises(ConfigError, match=r"segmenter\.ring"):
                parse_config({"segmenter": {"ring": value}}, where="test")
    assert explained("cameras.front.belt_distance_m").range == "above 0, to 10"
    assert explained("cameras.front.belt_distance_m").unit == "m"
    assert explained("segmenter.min_area_mm2").unit == "mm²"
    assert explained("cameras.left.source").range == '`"recording"`, `"realsense"`, `"ros2"`'
    assert explained("cameras.left.source") == explained(f"cameras.{CAMERA}.source")


def test_an_unknown_key_names_the_ones_that_may_be_meant() -> None:
    with pytest.raises(ConfigError, match=r"no key 'ring'; did you mean segmenter\.ring\?"):
        explained("ring")
    with pytest.raises(ConfigError, match=r"did you mean .*segmenter\.gate_mm"):
        explained("segmenter.gate_m")
    with pytest.raises(ConfigError, match="tuberline config show"):
        explained("x")


def test_the_page_has_a_row_for_each_key() -> None:
    rows = [line for line in config_page().splitlines() if line.startswith("| `")]
    assert len(rows) == len(settings())
    assert {len(row.replace(r"\|", "").split("|")) for row in rows} == {9}


BESIDE = {
    "cameras.<camera>.starts_at_s": "waits = false",
    "cameras.<camera>.serial": 'source = "realsense"',
    "cameras.<camera>.topic": 'source = "ros2"',
    "cameras.<camera>.info_topic": 'source = "ros2"',
    "cameras.<camera>.ros_": 'source = "ros2"',
    "cameras.<camera>.realsense.": '[cameras.front]\nsource = "realsense"',
    "belt.gauge_width_m": 'gauge = "belt-width"',
    "belt.gauge_size_mm": 'gauge = "bar"\ngauge_place_mm = [0, -420, 100]',
    "belt.gauge_place_mm": 'gauge = "bar"\ngauge_size_mm = [40, 30]',
    "belt.gauge": 'surface = "rods"',
    "belt.rod": 'surface = "rods"',
    "alarms.": 'channels = ["https://farm.example"]',
    "encoder.source": "metres_per_pulse = 0.0005",
    "encoder.metres_per_pulse": 'source = "tcp://127.0.0.1:5000"',
    "encoder.": 'source = "tcp://127.0.0.1:5000"\nmetres_per_pulse = 0.0005',
    "gnss.": 'source = "gpsd://host"',
}
"""What a key needs beside it, by its beginning."""


def test_every_example_is_accepted() -> None:
    for setting in settings():
        section, _, name = setting.key.replace(CAMERA, "front").rpartition(".")
        beside = next((more for begins, more in BESIDE.items() if setting.key.startswith(begins)), "")
        before = beside if beside.startswith("[") else ""
        head = f"[{section}]\n" if section else ""
        own = f"{name} = {setting.example.strip('`')}\n"
        more = f"{beside}\n" if beside and not before and not beside.startswith(f"{name} ") else ""
        parse_config(tomllib.loads(f"{before}\n{head}{own}{more}"), where=setting.key)
    assert explained("belt.gauge_size_mm").type == "list of numbers"
    assert explained("cameras.front.realsense.exposure_us").unit == "µs"


def test_config_show_explains_one_key() -> None:
    command = [sys.executable, "-m", "tuberline", "config", "show", "--explain"]
    text = subprocess.run([*command, "link.lease_ms"], capture_output=True, text=True, check=True, timeout=60).stdout
    assert "unit     ms" in text
    assert "range    from 200 to 60000" in text
    row = subprocess.run(
        [*command, "link.lease_ms", "--json"], capture_output=True, text=True, check=True, timeout=60
    ).stdout
    assert json.loads(row)["default"] == "`2000`"
    refused = subprocess.run([*command, "link.lease"], capture_output=True, text=True, check=False, timeout=60)
    assert refused.returncode == 2
    assert "link.lease_ms" in refused.stderr
