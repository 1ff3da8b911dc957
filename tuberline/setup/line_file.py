"""A line's file with a remark on what one may want to change."""

from __future__ import annotations

import json
import os
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

WIDTH = 34
"""Column where remarks begin, where the setting is short enough."""

_REMARKS = {
    "source": "recording, realsense or ros2",
    "path": "relative to this file",
    "camera": "which one of that recording",
    "speed": "times real time; 0: as fast as the line takes it",
    "serial": "of the device; without it the first one that is connected",
    "topic": "its CameraInfo is taken from beside it; else give info_topic",
    "ros_router": "their rmw_zenohd",
    "ros_domain": "their ROS_DOMAIN_ID",
    "belt_distance_m": "camera to belt along the optical axis, metres",
}

_RESTING = (
    ("resting_offset_mm", 5.5, "undersides lie this far below the plane the camera sees"),
    ("resting_sd_mm", 1.5, "how well that is known; `tuberline calibrate bucket` finds it"),
)


def line_file(
    name: str,
    cameras: Mapping[str, Mapping[str, Any]],
    *,
    file: Path,
    distance_known: bool,
    processes: int,
    belt: Mapping[str, float],
) -> str:
    """The text of the line's file at `file`.

    Args:
        cameras: settings of each section; paths are made relative to the file's folder.
        distance_known: the recordings say how far their belts are.
        belt: the resting level that they state.
    """
    parts = [_head(name, file)]
    live = sum("path" not in settings for settings in cameras.values())
    for camera, settings in cameras.items():
        parts.append(_camera(camera, settings, file.resolve().parent, distance_known=distance_known))
        if "path" not in settings and live > 1:
            parts.append(_aside("across_m", 0.0, "where it hangs across the belt; `tuberline calibrate cameras`"))
    parts.append(_rest(name, processes, belt))
    if live:
        parts.append("\n# [encoder]\n")
        parts.append(_aside("source", "serial:/dev/ttyACM0?baud=115200", "of the belt's shaft: docs/encoder.md"))
        parts.append(_aside("metres_per_pulse", 0.0005, "`tuberline doctor` compares it with the load"))
    return "".join(parts)


def _head(name: str, file: Path) -> str:
    about = textwrap.wrap(
        f"Line '{name}', written by `tuberline init`. Every key with its range stands in docs/config.md; `tuberline "
        f"config show --explain KEY` tells one. After a change: `tuberline config check {file}`.",
        96,
    )
    return (
        "\n".join(f"# {line}" for line in about) + "\n\n" + _row("name", name, "its topics lie under tuberline/<name>/")
    )


def _camera(camera: str, settings: Mapping[str, Any], base: Path, *, distance_known: bool) -> str:
    lines = [f"\n[cameras.{toml_key(camera)}]\n"]
    for key, value in settings.items():
        shown = _relative(value, base) if isinstance(value, Path) else value
        lines.append(_row(key, shown, _REMARKS.get(key, "")))
    if "belt_distance_m" not in settings:
        known = (
            "the recording says it; this would be used instead"
            if distance_known
            else "measure it: a ruler, then `tuberline calibrate belt`"
        )
        lines.append(_aside("belt_distance_m", 0.46, known))
    return "".join(lines)


def _rest(name: str, processes: int, belt: Mapping[str, float]) -> str:
    return "".join(
        [
            "\n[belt]\n",
            _aside("surface", "rods", "a web; then rod_pitch_mm and rod_diameter_mm too"),
            *(
                _row(key, belt[key], f"{remark}; the recording states it")
                if key in belt
                else _aside(key, typical, remark)
                for key, typical, remark in _RESTING
            ),
            "\n[segmenter]\n",
            _row("belt_sd_mm", 2.0, "how well the belt's height is known: 0.5 calibrated, 2 measured once"),
            _aside("method", "classical", "counts all; the default tells clods and stones from tubers"),
            "\n[regressor]\n",
            _row("processes", processes, "that weigh, on this machine; more may join from others"),
            _row("state_dir", f"runs/{name}/weights", "keeps weights that are given to the running line"),
            "\n[aggregator]\n",
            _row("out", f"runs/{name}", "ledger.db, summary.json, tubers.csv; relative to this file"),
            _aside("tickets", "tickets.json", "what a scale said: `tuberline calibrate`"),
            "\n[link]\n",
            _aside("router", "tcp/0.0.0.0:7447", "to be reached from other machines; then see docs/security.md"),
            "\n# [alarms]\n",
            _aside("channels", ["https://example.org/hook"], "where alarms go: docs/alarms.md"),
        ]
    )


def _row(key: str, value: Any, remark: str) -> str:
    """A setting and what it is for. JSON writes numbers, texts and lists of texts as TOML does."""
    setting = f"{key} = {json.dumps(value)}"
    return f"{setting:<{WIDTH}}  # {remark}\n" if remark else f"{setting}\n"


def _aside(key: str, value: Any, remark: str) -> str:
    """The same as an example that is not in use."""
    return _row(f"# {key}", value, remark)


def toml_key(name: str) -> str:
    """A name as a key of TOML, in quotes where it needs them."""
    return name if all(letter.isalnum() or letter in "-_" for letter in name) else f'"{name}"'


def _relative(path: Path, base: Path) -> str:
    absolute = path.resolve()
    try:
        relative = os.path.relpath(absolute, base)
    except ValueError:  # another drive
        return str(absolute)
    return str(absolute) if relative.startswith(os.path.join("..", "..", "..")) else relative
