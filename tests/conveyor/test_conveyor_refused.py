"""What pydantic finds wrong is told in plain words, with the unit of the field."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from conveyor.config import parse_config
from conveyor.contract import read_contract
from conveyor.errors import ConfigError, InputError
from conveyor.formats.folder.layout import read_camera_file
from conveyor.load_orders import check_order
from conveyor.messages import LoadOrder
from conveyor.refused import all_in_words


class Given(BaseModel):
    """One field of each kind."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    path: Path = Path("x")
    name: Annotated[str, Field(min_length=1, max_length=3, pattern=r"^[^\x00-\x1f\x7f]*$")] = "a"
    code: Annotated[str, Field(pattern="^[0-9]+$")] = "1"
    far_m: Annotated[float, Field(gt=0, le=10)] = 1.0
    late_ms: Annotated[int, Field(ge=5, lt=50)] = 5
    cells_mm: Annotated[list[Annotated[float, Field(ge=2.5)]], Field(min_length=1, max_length=2)] = [3.0]
    count: Annotated[int, Field(ge=1)] = 1
    on: bool = True
    kind: Literal["rods", "belt"] = "rods"
    table: dict[str, int] = {}
    needed: int


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("path", 5, "path must be a path, written as text"),
        ("name", "a\n", "name must be one line of text without control characters"),
        ("name", "", "name must have at least 1 character"),
        ("name", "four", "name must have at most 3 characters"),
        ("name", 4, "name must be text"),
        ("code", "x", "code must match the pattern '^[0-9]+$'"),
        ("far_m", 460, "far_m must be at most 10 m"),
        ("far_m", 0, "far_m must be more than 0 m"),
        ("far_m", "far", "far_m must be a number"),
        ("far_m", float("nan"), "far_m must be a finite number"),
        ("late_ms", 4, "late_ms must be at least 5 ms"),
        ("late_ms", 50, "late_ms must be less than 50 ms"),
        ("late_ms", 5.5, "late_ms must be a whole number"),
        ("cells_mm", [1, 3], "cells_mm.0 must be at least 2.5 mm"),
        ("cells_mm", [3, 3, 3], "cells_mm must have at most 2 items"),
        ("cells_mm", 3, "cells_mm must be a list"),
        ("count", 0, "count must be at least 1"),
        ("on", "perhaps", "on must be true or false"),
        ("kind", "mud", "kind must be 'rods' or 'belt'"),
        ("table", 3, "table must be a table of names and values"),
        ("needed", None, "needed must be a whole number"),
        ("other", 1, "other is unknown"),
    ],
)
def test_every_kind_of_fault_has_plain_words(field: str, value: Any, told: str) -> None:
    with pytest.raises(ValidationError) as error:
        Given.model_validate({"needed": 1, field: value})
    assert all_in_words(error.value) == told


def test_what_is_not_given_is_missing() -> None:
    with pytest.raises(ValidationError) as error:
        Given.model_validate({"count": 0})
    assert all_in_words(error.value) == "count must be at least 1; needed is missing"


@pytest.mark.parametrize(
    ("raw", "told"),
    [
        ({"cameras": {"front": {"path": 5}}}, "cameras.front.path: must be a path, written as text (got 5)"),
        ({"cameras": {"front": {"belt_distance_m": 460}}}, "belt_distance_m: must be at most 10 m (got 460)"),
        ({"cameras": {"front": {"direct": "here"}}}, "must be auto, off, unixsock-stream/PATH or tcp/127.0.0.1:PORT"),
        ({"segmenter": 3}, "segmenter: must be a table of names and values (got 3)"),
    ],
)
def test_a_lines_file_is_refused_in_plain_words(raw: dict[str, Any], told: str, tmp_path: Path) -> None:
    """'Input is not a valid path for <class 'pathlib.Path'>' was said, and limits had no unit."""
    with pytest.raises(ConfigError) as error:
        parse_config(raw, where="line.toml", base=tmp_path)
    assert told in str(error.value)


def test_a_contract_a_camera_file_and_an_order_are_refused_in_plain_words(tmp_path: Path) -> None:
    contract = tmp_path / "buyer.toml"
    contract.write_text('name = "a\\nb"\n[[classes]]\nname = "small"\nto_mm = -1\n', encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        read_contract(contract)
    assert "name: must be one line of text without control characters (got 'a\\nb')" in str(refused.value)
    assert "to_mm: must be at least 0 mm (got -1)" in str(refused.value)
    camera = tmp_path / "camera.json"
    numbers = {"name": "front", "width": 0, "height": 480, "fx": 1.0, "fy": 1.0, "cx": 1.0, "cy": 1.0}
    camera.write_text(json.dumps({**numbers, "depth_scale_m": 0.001, "belt_distance_m": 460}), encoding="utf-8")
    with pytest.raises(InputError) as unusable:
        read_camera_file(camera)
    assert "width: must be more than 0 (got 0)" in str(unusable.value)
    assert "belt_distance_m: must be at most 10 m (got 460)" in str(unusable.value)
    with pytest.raises(InputError, match=r"kg: must be at most 200000 kg \(got 500000"):
        check_order(LoadOrder("order-1", "ticket", kg=500_000.0))
    with pytest.raises(InputError, match=r"fields\.name: must be one line of text without control characters"):
        check_order(LoadOrder("order-1", "start", fields={"name": "a\nb"}))
