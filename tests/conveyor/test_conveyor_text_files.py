"""Files that a person or another program wrote: with a byte-order mark as without, and refused in one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from aggregator.calibration.tickets import read_tickets
from aggregator.scoring.classes import true_percents
from aggregator.scoring.truth import read_truth
from conveyor.config import load_config
from conveyor.contract import Contract, read_contract
from conveyor.errors import TuberlineError
from conveyor.formats.detect import camera_names
from conveyor.formats.folder.layout import read_camera_file
from conveyor.formats.plain.pinhole import read_pinhole
from conveyor.formats.positions import read_positions
from regressor.studies.ablate import read_table
from regressor.studies.saved import Saved
from segmenter.studies.distractors import load_truth
from tuberline.api.recordings import Recording
from viewer.page.acting import read_order

CONTRACT = 'classes = [{ name = "small", to_mm = 45 }, { name = "large", from_mm = 45 }]\n'
TUBER = {"id": 1, "place_x_m": 0.1, "place_y_m": 0.0, "weight_g": 120.0, "length_mm": 80.0, "square_mesh_mm": 50.0}
TRUTH = json.dumps({"tubers": [TUBER], "distractor_places": []})
CAMERA = json.dumps(
    {"name": "front", "width": 4, "height": 4, "fx": 4.0, "fy": 4.0, "cx": 2.0, "cy": 2.0, "depth_scale_m": 0.001}
)


def shares(path: Path) -> list[float]:
    """The true shares of two classes."""
    buyer = path.with_name("buyer.toml")
    buyer.write_text(CONTRACT, encoding="utf-8")
    return true_percents(path, read_contract(buyer))


def beside(path: Path) -> Path:
    """The recording that the file belongs to."""
    camera = path.parent / "front" / "camera.json"
    camera.parent.mkdir(exist_ok=True)
    camera.write_text(CAMERA, encoding="utf-8")
    return path.parent


READERS: dict[str, tuple[str, str, Callable[[Path], Any]]] = {
    "config": ("line.toml", 'name = "north"\n', lambda path: load_config(path).name),
    "contract": ("contract.toml", CONTRACT, lambda path: Contract.model_dump(read_contract(path))),
    "tickets": ("tickets.json", '{"format": 2, "tickets": []}', read_tickets),
    "truth": ("truth.json", TRUTH, read_truth),
    "true classes": ("truth.json", TRUTH, shares),
    "truth of the API": ("truth.json", TRUTH, lambda path: Recording(beside(path), "folder", ()).truth()),
    "truth of the clods": ("truth.json", TRUTH, lambda path: repr(load_truth(beside(path), "front"))),
    "camera": ("camera.json", CAMERA, read_camera_file),
    "cameras of a line": ("line.json", '{"cameras": ["front"]}', lambda path: camera_names(beside(path))),
    "intrinsics": ("k.json", CAMERA, read_pinhole),
    "ablations": ("ablation.json", '{"table": {}, "recipe": "ours"}', lambda path: read_table(path.parent)),
    "results": ("field/metrics.json", "{}", lambda path: Saved(path.parents[1]).evaluation("field")),
    "positions": ("track.csv", "time,lat,lon\n2026-10-01T08:00:00Z,52.1,5.6\n", read_positions),
}


@pytest.fixture(params=READERS, ids=lambda name: name.replace(" ", "-"))
def reader(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, str, Callable[[Path], Any]]:
    """A place for a file, a text that it may hold, and what reads it."""
    name, text, read = READERS[request.param]
    (tmp_path / name).parent.mkdir(exist_ok=True)
    return tmp_path / name, text, read


def test_a_byte_order_mark_is_no_part_of_a_text(reader: tuple[Path, str, Callable[[Path], Any]]) -> None:
    """'Invalid statement (at line 1, column 1)' was said of a config that Windows' editor had saved."""
    path, text, read = reader
    path.write_text(text, encoding="utf-8")
    plain = read(path)
    path.write_text(text, encoding="utf-8-sig")
    assert read(path) == plain


@pytest.mark.parametrize(
    "data", [b"[" * 100_000, b"9" * 5000, b"\xff\xfe\x00", b"{", b""], ids=["deep", "digits", "bytes", "cut", "empty"]
)
def test_what_cannot_be_read_is_one_sentence_that_names_the_file(
    reader: tuple[Path, str, Callable[[Path], Any]], data: bytes
) -> None:
    """Lists in lists in lists ended `score --contract` and others with a traceback."""
    path, _, read = reader
    if path.suffix == ".toml" and not data:
        return  # an empty one is a whole line, of defaults, or a contract that lacks its name
    path.write_bytes(data)
    with pytest.raises(TuberlineError) as refused:
        read(path)
    assert path.name in str(refused.value)


NULLS = {
    "truth": dict.fromkeys(("length_mm", "width_mm", "cameras", "square_mesh_mm")),
    "true classes": dict.fromkeys(("length_mm", "cameras")),
    "truth of the clods": dict.fromkeys(("length_mm", "cameras")),
    "camera": dict.fromkeys(("fps", "belt_distance_m", "belt_from_camera", "resting_offset_mm", "resting_sd_mm")),
}


@pytest.mark.parametrize("name", NULLS)
def test_null_is_as_good_as_no_key(name: str, tmp_path: Path) -> None:
    """`score` refused a truth whose maker had measured no lengths, and wrote null for each."""
    file, text, read = READERS[name]
    told = json.loads(text)
    rows = told.get("tubers", [told])
    for row in rows:
        for key in NULLS[name]:
            row.pop(key, None)
    (tmp_path / file).write_text(json.dumps(told))
    without = read(tmp_path / file)
    for row in rows:
        row.update(NULLS[name])
    nothing = {"distractor_places": None, "distractors": None} if "tubers" in told else {}
    (tmp_path / file).write_text(json.dumps(told | nothing))
    assert read(tmp_path / file) == without


@pytest.mark.parametrize("end", ["\r", "\r\n"])
def test_lines_of_positions_end_as_they_like(end: str, tmp_path: Path) -> None:
    """A file of an old Mac's line ends, or of one endless cell, ended a map with a traceback."""
    file, text, read = READERS["positions"]
    (tmp_path / file).write_bytes(text.encode())
    plain = read(tmp_path / file)
    (tmp_path / file).write_bytes(text.replace("\n", end).encode())
    assert read(tmp_path / file) == plain
    (tmp_path / file).write_text(text + '"' + 200_000 * "x")
    with pytest.raises(TuberlineError, match=r"track\.csv is not CSV text: field larger"):
        read(tmp_path / file)


def test_an_order_of_lists_in_lists_is_refused() -> None:
    with pytest.raises(TuberlineError, match="no JSON"):
        read_order(b"[" * 4096)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a = 1\na = 2\n", "line 2, `a = 2`: this key is given a second time: keep one of both"),
        ("[a]\nb = 1\n\n[a]\n", "line 4, `[a]`: this section is begun a second time: put all of its keys below one"),
        ("a = True", 'line 1, `a = True`: a value is text in "quotes", a number as 1.5, or true or false in small'),
        ("b = 1\n  a = north\n", 'line 2, `a = north`: a value is text in "quotes"'),
        ("a = 0,46\n", "line 1, `a = 0,46`: one value ends here: a number is written as 1.5, without comma, unit"),
        ("a: 1\n", "line 1, `a: 1`: a line is `key = value` or `[section]`, and a remark begins with #"),
        ("// rods\n", "line 1, `// rods`: a line is `key = value` or `[section]`, and a remark begins with #"),
        ('a = "north\nb = 1\n', 'line 1, `a = "north`: a text ends with its quote on the same line'),
        ('a = "C:\\Users"\n', 'line 1, `a = "C:\\Users"`: in "double quotes" each \\ of a path is doubled'),
        ("a = [1, 2\n\n", "line 1, `a = [1, 2`: a list that begins with [ ends with ]"),
        ("a" * 200, f"line 1, `{'a' * 80}...`: a line is `key = value`"),
    ],
)
def test_what_is_no_toml_is_told_with_its_line_and_how_to_write_it(tmp_path: Path, text: str, told: str) -> None:
    """It was `Cannot overwrite a value (at line 6, column 8)`: which one, and what to do, was left open."""
    file = tmp_path / "line.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(TuberlineError) as caught:
        load_config(file)
    assert str(caught.value).startswith(f"config {file} is not TOML: {told}")
