"""What both packs share: a table of named arrays, shards read with suspicion, and meta.json."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor import __version__
from conveyor.errors import InputError
from conveyor.formats.numpy_files import numpy_fault
from conveyor.formats.versions import check_version

META = "meta.json"


@dataclass(frozen=True, slots=True)
class NamedArray:
    """One array of a shard.

    Attributes:
        shape: with n for the shard's views or frames.
        says: what it holds, with its unit.
        needed: a shard without it cannot be used.
    """

    name: str
    shape: str
    says: str
    needed: bool = True


def read_shard(path: Path, table: tuple[NamedArray, ...]) -> dict[str, NDArray[Any]]:
    """All arrays of a shard, those included that the table does not know.

    Raises:
        InputError: unreadable, or without an array that is needed.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            data = {key: file[key] for key in file.files}
    except (OSError, ValueError, KeyError, EOFError, AttributeError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"shard {path} cannot be read: {numpy_fault(path, error)}; make the pack again") from error
    missing = [array.name for array in table if array.needed and array.name not in data]
    if missing:
        raise InputError(f"shard {path} lacks {', '.join(missing)}; it has {', '.join(sorted(data)) or 'nothing'}")
    return data


def read_meta(folder: Path, *, newest: int, what: str) -> dict[str, Any]:
    """meta.json of a pack; nothing where there is none, which is version 1.

    Raises:
        InputError: unreadable, or of a version that this program does not read.
    """
    path = folder / META
    if not path.is_file():
        return {}
    try:
        meta = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be read: {error}; make the pack again") from error
    if not isinstance(meta, dict):
        raise InputError(f"{path} holds a {type(meta).__name__}, not a JSON object; make the pack again")
    check_version(meta.get("version"), newest=newest, what=what, where=path)
    return meta


def write_meta(folder: Path, *, version: int, what: Mapping[str, Any]) -> None:
    """meta.json: the format's version, what the pack is, and by which program it was made."""
    meta = {"version": version, **what, "tuberline": __version__, "numpy": np.__version__}
    (folder / META).write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")
