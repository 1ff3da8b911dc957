"""Text, JSON and TOML that a person or another program wrote: read, or refused in one sentence.

Editors and spreadsheets of Windows begin a file with a byte-order mark; it is no part of the text.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from conveyor.errors import InputError, TuberlineError
from conveyor.toml_words import toml_fault


def read_text(path: Path, *, what: str = "", error: type[TuberlineError] = InputError) -> str:
    """All of a text file. `what` it is stands before its name in what is said, as in 'truth x.json'.

    Raises:
        error: it is not there, may not be read, or is no UTF-8.
    """
    where = f"{what} {path}".strip()
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as fault:
        raise error(f"{where} cannot be read: {fault.strerror or fault}") from fault
    except UnicodeDecodeError as fault:
        raise error(f"{where} is no text: {fault}; save it as UTF-8") from fault


def read_json(path: Path, *, what: str = "", error: type[TuberlineError] = InputError) -> Any:
    """What a JSON file holds.

    Raises:
        error: as `read_text`, or it is not JSON.
    """
    return json_of(read_text(path, what=what, error=error), where=f"{what} {path}".strip(), error=error)


def read_toml(path: Path, *, what: str = "", error: type[TuberlineError] = InputError) -> dict[str, Any]:
    """What a TOML file holds.

    Raises:
        error: as `read_text`, or it is not TOML.
    """
    text = read_text(path, what=what, error=error)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as fault:  # among them numbers too long and lists too deep to read
        raise error(f"{what} {path}".strip() + f" is not TOML: {toml_fault(text, fault)}") from fault


def json_of(text: str | bytes, *, where: str, error: type[TuberlineError] = InputError) -> Any:
    """What JSON says; of bytes, a byte-order mark is no part.

    Raises:
        error: it is not JSON; told with `where` it stands.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as fault:  # no JSON, no UTF-8, numbers too long and lists too deep to read
        raise error(f"{where} is not JSON: {fault}") from fault
