"""The whole balance sheet of a run, from its ledger: per camera and hop, and the ledger's own."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from aggregator.core.balance import Equation, camera_equations, ledger_equations
from aggregator.ledger.reader import RunRow, read_marks
from conveyor.messages import Mark


@dataclass(frozen=True, slots=True)
class Audit:
    """Balance sheets of a run. `cameras` maps to the newest mark and the counted entries of that camera's log."""

    run: str
    finished: bool
    marks: Mapping[str, Mark | None]
    equations: Mapping[str, list[Equation]]
    tracks: Mapping[str, int]
    """Observations by role, and 'pending'."""
    set_aside: Mapping[str, int]
    """Entries of a camera's log that could not be read: what they said is lost."""

    @property
    def balanced(self) -> bool:
        """Every equation holds."""
        return all(equation.difference == 0 for equations in self.equations.values() for equation in equations)

    def as_dict(self) -> dict[str, Any]:
        """For machines: sheets, equations with both sides, and whether all hold."""
        return {
            "run": self.run,
            "finished": self.finished,
            "balanced": self.balanced,
            "cameras": {camera: sheet(mark) for camera, mark in self.marks.items()},
            "tracks": dict(self.tracks),
            "set_aside": dict(self.set_aside),
            "equations": {
                where: [
                    {"law": e.text, "left": e.left, "right": e.right, "difference": e.difference} for e in equations
                ]
                for where, equations in self.equations.items()
            },
        }


def sheet(mark: Mark | None) -> dict[str, Any]:
    """One camera's balance sheet as plain values; a camera that never sent a mark says so."""
    if mark is None:
        return {"state": "never heard", "frames": {}, "views": {}, "tracks": {}}
    return {
        "state": "ended" if mark.final else "running",
        "frames": dict(mark.frames),
        "views": dict(mark.views),
        "tracks": dict(mark.tracks),
        "looked_at_m": mark.looked_at_m,
        "travelled_m": mark.travelled_m,
        "travel_estimated": mark.travel_estimated,
    }


def audit_run(db: sqlite3.Connection, run: RunRow) -> Audit:
    """The balance sheet of `run` as the ledger holds it, finished or not."""
    marks = read_marks(db, run.run)
    roles = dict(db.execute("SELECT role, count(*) FROM observation WHERE run = ? GROUP BY role", (run.run,)))
    equations = {camera: camera_equations(mark) for camera, mark in marks.items()}
    per_camera = dict(
        db.execute("SELECT camera, count(*) FROM entry WHERE run = ? AND kind = 'track' GROUP BY camera", (run.run,))
    )
    repeats = dict(
        db.execute(
            "SELECT camera, count(*) FROM observation WHERE run = ? AND role = 'repeat' GROUP BY camera", (run.run,)
        )
    )
    for camera, mark in marks.items():
        if mark.final:  # a replay that went back to its first frame has logged tracks again, and counted them once
            counted, logged = mark.tracks.get("counted", 0), per_camera.get(camera, 0) - repeats.get(camera, 0)
            equations[camera].append(
                Equation("tracks counted by the camera = tracks in the ledger, repeats aside", counted, logged)
            )
    set_aside = dict(
        db.execute("SELECT camera, count(*) FROM entry WHERE run = ? AND kind = 'refused' GROUP BY camera", (run.run,))
    )
    for camera, refused in sorted(set_aside.items()):
        equations.setdefault(camera, []).append(Equation("entries that could not be read = none", refused, 0))
    pending = _pending(db, run.run)
    (tubers,) = db.execute("SELECT count(*) FROM tuber WHERE run = ?", (run.run,)).fetchone()
    (groups,) = db.execute(
        "SELECT count(DISTINCT tuber_id) FROM observation WHERE run = ? AND role = 'counted'", (run.run,)
    ).fetchone()
    equations["ledger"] = ledger_equations(
        roles, track_entries=sum(per_camera.values()), pending=pending, tubers=tubers, groups=groups
    )
    return Audit(
        run=run.run,
        finished=run.finished,
        marks={camera: marks.get(camera) for camera in run.cameras},
        equations=equations,
        tracks={**{str(role): int(n) for role, n in roles.items()}, "pending": pending},
        set_aside=set_aside,
    )


def _pending(db: sqlite3.Connection, run: str) -> int:
    (count,) = db.execute(
        "SELECT count(*) FROM entry WHERE run = ? AND kind = 'track' AND NOT EXISTS (SELECT 1 FROM observation AS seen "
        "WHERE seen.run = entry.run AND seen.camera = entry.camera AND seen.n = entry.n)",
        (run,),
    ).fetchone()
    return int(count)
