"""Every key of a line's file with type, default, range, unit, meaning and an example, from the schema of the config."""

from __future__ import annotations

import difflib
import json
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import astuple, dataclass
from typing import Any

from conveyor.config import LineConfig
from conveyor.errors import ConfigError
from conveyor.refused import unit_of
from tuberline.cli.config_examples import example

CAMERA = "<camera>"
"""Stands for a camera's name in a key."""
WIDTH = 100
"""Characters of a line of prose."""
HEAD = """# Configuration

Made from `conveyor/config.py` by `make docs`. One TOML file describes one line. Every key has a
default; a key that is unknown or a value that is out of range is refused, with the nearest known key
or with what is allowed. A relative path starts from the file's own folder.

```toml
name = "north"

[cameras.front]                  # one section for each camera, under its name
path = "recordings/monday"
speed = 0

[aggregator]
out = "runs/monday"
```

These commands check a file, print every setting in effect, and explain one key:

    tuberline config check line.toml
    tuberline config show line.toml
    tuberline config show --explain segmenter.ring
    tuberline config schema                              # JSON schema, for editors
"""
_UNITS_OF = {
    "cameras.<camera>.depth_scale_m": "m per unit of depth",
    "cameras.<camera>.speed": "times real time",
    "cameras.<camera>.window": "frames",
    "segmenter.max_pending_views": "views",
    "segmenter.reject_below": "log-odds",
    "segmenter.ring": "frames",
}
"""Units that no name ends with."""
_TYPES = {
    "string": "text",
    "number": "number",
    "integer": "whole number",
    "boolean": "true or false",
}
_LISTS = {"string": "list of text", "number": "list of numbers", "array": "list of lists of numbers"}


@dataclass(frozen=True, slots=True)
class Setting:
    """One key of the config, in words."""

    key: str
    type: str
    default: str
    range: str
    unit: str
    meaning: str
    example: str


def settings() -> list[Setting]:
    """All keys in the order of the schema; a camera's are written `cameras.<camera>.KEY`."""
    schema = LineConfig.model_json_schema()
    return list(_section(schema, schema, prefix=""))


def explained(key: str) -> Setting:
    """The setting that `key` names; `cameras.front.path` and `cameras.<camera>.path` are the same one.

    Raises:
        ConfigError: there is no such key; the text names the nearest ones.
    """
    known = {setting.key: setting for setting in settings()}
    parts = key.split(".")
    if parts[0] == "cameras" and len(parts) in (3, 4):
        parts[1] = CAMERA
    if (wanted := ".".join(parts)) in known:
        return known[wanted]
    near = [name for name in known if name.rpartition(".")[2] == parts[-1]]
    near = near or difflib.get_close_matches(wanted, known, n=3, cutoff=0.5)
    hint = f"did you mean {', '.join(near)}?" if near else "all keys: `tuberline config show`"
    raise ConfigError(f"the config has no key '{key}'; {hint}")


def config_page() -> str:
    """docs/config.md."""
    tables: dict[str, list[Setting]] = {}
    for setting in settings():
        tables.setdefault(setting.key.rpartition(".")[0], []).append(setting)
    about = _docstrings()
    return HEAD + "".join(_table(section, rows, about[section]) for section, rows in tables.items())


def _table(section: str, rows: list[Setting], about: str) -> str:
    head = ("key", "type", "default", "range", "unit", "meaning", "example")
    lines = [head, ("---",) * len(head)]
    lines += [
        (f"`{row.key.rpartition('.')[2]}`", *(cell.replace("|", r"\|") for cell in astuple(row)[1:])) for row in rows
    ]
    title = f"`[{section}]`" if section else "The line itself"
    prose = "\n\n".join(textwrap.fill(part, WIDTH) for part in about.split("\n\n"))
    return f"\n## {title}\n{prose}\n\n" + "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _docstrings() -> dict[str, str]:
    """What the schema says of each section, by the section's key."""
    schema = LineConfig.model_json_schema()
    return {"": schema["description"], **dict(_about(schema, schema, prefix=""))}


def _about(section: Mapping[str, Any], schema: Mapping[str, Any], *, prefix: str) -> Iterator[tuple[str, str]]:
    for name, field in section["properties"].items():
        if inner := _section_of(field, schema):
            key = prefix + (f"{name}.{CAMERA}" if "additionalProperties" in field else name)
            yield key, inner["description"]
            yield from _about(inner, schema, prefix=f"{key}.")


def _section(section: Mapping[str, Any], schema: Mapping[str, Any], *, prefix: str) -> Iterator[Setting]:
    nested = []
    for name, field in section["properties"].items():
        if inner := _section_of(field, schema):
            nested.append((inner, f"{name}.{CAMERA}." if "additionalProperties" in field else f"{name}."))
        else:
            yield _setting(prefix + name, field)
    for inner, path in nested:
        yield from _section(inner, schema, prefix=prefix + path)


def _section_of(field: Mapping[str, Any], schema: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The section that a field of the schema is or may be; None where it is a value."""
    for part in (field, *field.get("anyOf", ()), field.get("additionalProperties", {})):
        if isinstance(part, dict) and "$ref" in part:
            found: Mapping[str, Any] = schema["$defs"][part["$ref"].rpartition("/")[2]]
            return found
    return None


def _setting(key: str, field: Mapping[str, Any]) -> Setting:
    value = next((part for part in field.get("anyOf", ()) if part.get("type") != "null"), field)
    return Setting(
        key=key,
        type=_type(value),
        default=_default(field),
        range=_range(value),
        unit=_UNITS_OF.get(key) or unit_of(key),
        meaning=field.get("description", ""),
        example=f"`{example(key, value, field.get('default'))}`",
    )


def _type(value: Mapping[str, Any]) -> str:
    if "enum" in value or "const" in value:
        return "one of"
    if value.get("type") == "array":
        (inner,) = {item["type"] for item in [*value.get("prefixItems", ()), value.get("items")] if item}
        return _LISTS[inner]
    return "path" if value.get("format") == "path" else _TYPES[value["type"]]


def _default(field: Mapping[str, Any]) -> str:
    default = field.get("default")
    return "none" if default is None else f"`{json.dumps(default)}`"


def _range(value: Mapping[str, Any]) -> str:
    if "enum" in value:
        return ", ".join(f"`{json.dumps(item)}`" for item in value["enum"])
    if "const" in value:
        return f"`{json.dumps(value['const'])}`, or left out"
    low, high = value.get("minimum"), value.get("maximum")
    above = value.get("exclusiveMinimum")
    words = [f"above {above:g}" + ("," if high is not None else "")] if above is not None else []
    if low is not None:
        words.append(f"from {low:g}")
    if high is not None:
        words.append(f"to {high:g}")
    return " ".join(words)
