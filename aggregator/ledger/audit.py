"""The whole balance sheet of a run, from its ledger: per camera and hop, and the ledger's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from aggregator.core.balance import Equation, camera_equations, ledger_equations
from aggregator.ledger.check import view_faults
from aggregator.ledger.ends import End, end_of
from aggregator.ledger.reader import RunRow, read_marks, read_sums, run_being_written
from aggregator.ledger.schema import TUBER
from aggregator.ledger.stated import summary_told
from aggregator.ledger.sums import RunSums
from aggregator.ledger.verified import LedgerView
from conveyor.errors import LedgerError
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
    set_aside: Mapping[str, int] = field(default_factory=dict)
    """Entries of a camera's log that could not be read: what they said is lost."""
    faults: tuple[str, ...] = ()
    """What is damaged in the ledger; an audit of sums alone looks for none."""
    end: End | None = None
    """How it ended; an audit of sums alone does not look."""

    @property
    def balanced(self) -> bool:
        """Every equation holds, and the ledger is as it was written."""
        return not self.faults and all(
            equation.difference == 0 for equations in self.equations.values() for equation in equations
        )

    def as_dict(self) -> dict[str, Any]:
        """For machines: sheets, equations with both sides, and whether all hold."""
        return {
            "run": self.run,
            "finished": self.finished,
            "end": self.end,
            "balanced": self.balanced,
            "faults": list(self.faults),
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


def audit_run(view: LedgerView, run: RunRow) -> Audit:
    """The balance sheet of `run`, finished or not, after every row of the ledger was verified and added up."""
    faults = tuple(view_faults(view))
    try:
        sums = read_sums(view, run.run)
        found = audit_sums(run, sums, read_marks(view, run), faults=faults)
        summary = summary_told(view, run.run, sums)
        return replace(found, end=end_of(run, run_being_written(view), sums=sums, summary=summary))
    except LedgerError as error:
        return Audit(run.run, run.finished, dict.fromkeys(run.cameras), {}, {}, faults=(*faults, str(error)))


def audit_sums(run: RunRow, sums: RunSums, marks: Mapping[str, Mark], *, faults: tuple[str, ...] = ()) -> Audit:
    """The balance sheet of `run` by the sums carried along, whatever its size."""
    equations = {camera: camera_equations(mark) for camera, mark in marks.items()}
    for camera, mark in marks.items():
        if mark.final:  # a replay that went back to its first frame has logged tracks again, and counted them once
            counted = mark.tracks.get("counted", 0) + mark.tracks.get("foreign", 0)
            logged = sums.tracks.get(camera, 0) - sums.repeats.get(camera, 0)
            equations[camera].append(
                Equation("tracks counted or kept by the camera = tracks in the ledger, repeats aside", counted, logged)
            )
    for camera, refused in sorted(sums.set_aside.items()):
        equations.setdefault(camera, []).append(Equation("entries that could not be read = none", refused, 0))
    equations["ledger"] = ledger_equations(
        sums.roles,
        track_entries=sum(sums.tracks.values()),
        pending=sums.pending,
        tubers=sums.count(TUBER),
        groups=sums.counted,
    )
    return Audit(
        run=run.run,
        finished=run.finished,
        marks={camera: marks.get(camera) for camera in run.cameras},
        equations=equations,
        tracks={**sums.roles, "pending": sums.pending},
        set_aside=dict(sums.set_aside),
        faults=faults,
    )
