"""A folder of saved results: what the evaluation page and the model card are both made from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conveyor.text_files import read_json


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
