"""A folder of saved results: what the evaluation page and the model card are both made from."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conveyor.errors import InputError


@dataclass(frozen=True, slots=True)
class Saved:
    """`folder` holds field/, easy/, worlds/, season/ (of `tuberline evaluate`), ablation/, drift/, speed/ and real/."""

    folder: Path

    def part(self, name: str) -> Path | None:
        """The folder of one result, or None where it was not made."""
        path = self.folder / name
        return path if path.is_dir() else None

    def evaluation(self, name: str) -> dict[str, Any] | None:
        """metrics.json of one evaluation, or None where it was not made."""
        path = self.folder / name / "metrics.json"
        return read_json(path) if path.is_file() else None

    @property
    def real(self) -> Path:
        """What `tuberline weigh --json` said of real clouds, each with its true_g."""
        return self.folder / "real" / "weighed.json"


def read_json(path: Path) -> Any:
    """A saved result.

    Raises:
        InputError: unreadable, or no JSON.
    """
    try:
        return json.loads(read_text(path))
    except ValueError as error:
        raise InputError(f"{path} is not JSON: {error}") from error


def read_text(path: Path) -> str:
    """A saved text.

    Raises:
        InputError: it cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}; make it first, see --help") from error
