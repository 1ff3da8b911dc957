"""truth.json: what really passed. Only `tuberline score` ever reads it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conveyor.errors import InputError
from conveyor.text_files import read_json

TRUTH_FILE = "truth.json"
LARGEST = 1e9
"""Beyond it is no place in metres, no weight in grams and no length in millimetres."""


@dataclass(frozen=True, slots=True)
class TrueTuber:
    """One tuber that passed: its place on the belt (metres), weight and longest axis."""

    name: str
    place_x_m: float
    place_y_m: float
    weight_g: float
    length_mm: float


def truth_file(path: Path) -> Path:
    """The file itself, of a recording's folder the truth.json in it."""
    return path / TRUTH_FILE if path.is_dir() else path


def read_truth(path: Path) -> list[TrueTuber]:
    """The tubers of `path`, in its order; further keys are allowed, and null is as good as no key. Of a folder, those
    of the truth.json in it.

    Raises:
        InputError: no such file, not JSON, or a key is missing or of the wrong kind; the text names it.
    """
    path = truth_file(path)
    raw = read_json(path, what="truth")
    if not isinstance(raw, dict) or not isinstance(raw.get("tubers"), list):
        raise InputError(f"truth {path} has no list 'tubers'; see docs/formats.md")
    tubers = [_tuber(item, path, at) for at, item in enumerate(raw["tubers"])]
    names = {tuber.name for tuber in tubers}
    if len(names) < len(tubers):
        raise InputError(f"truth {path} has {len(tubers)} tubers, but only {len(names)} different 'id'")
    return tubers


def _tuber(item: Any, path: Path, at: int) -> TrueTuber:
    where = f"truth {path}, tubers[{at}]"
    if not isinstance(item, dict):
        raise InputError(f"{where} is {type(item).__name__}, not an object")
    name = item.get("id")
    if isinstance(name, float) and name.is_integer():
        name = int(name)
    if isinstance(name, bool) or not isinstance(name, str | int):
        raise InputError(f"{where} needs 'id', a text or a whole number; got {name!r}")
    return TrueTuber(
        name=str(name),
        place_x_m=_number(item, "place_x_m", where),
        place_y_m=_number(item, "place_y_m", where),
        weight_g=_number(item, "weight_g", where, least=0.0),
        length_mm=_number(item, "length_mm", where, least=0.0, default=0.0),
    )


def _number(
    item: dict[str, Any], key: str, where: str, *, least: float = -LARGEST, default: float | None = None
) -> float:
    value = default if item.get(key) is None else item[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= LARGEST:
        bound = f" of at least {least:g}" if least > -LARGEST else ""
        raise InputError(f"{where} needs '{key}', a number{bound}; got {value!r}")
    return float(value)
