"""The balance sheet of a camera: equations that hold exactly, or by how much they do not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from conveyor.messages import Mark


@dataclass(frozen=True, slots=True)
class Equation:
    """One conservation law of one camera, e.g. 'published = received + gaps'."""

    text: str
    left: int
    right: int

    @property
    def difference(self) -> int:
        """Left minus right; 0 where the law holds."""
        return self.left - self.right


def camera_equations(mark: Mark) -> list[Equation]:
    """The laws of one camera's balance sheet (`conveyor.messages.Mark`), from source to log."""
    frames, views, tracks = mark.frames, mark.views, mark.tracks
    equations = []
    if "published" in frames:
        equations.append(
            Equation(
                "frames: published = received + gaps",
                frames["published"],
                frames.get("received", 0) + frames.get("gaps", 0),
            )
        )
    equations += [
        Equation(
            "frames: received = processed + dropped",
            frames.get("received", 0),
            frames.get("processed", 0) + _sum(frames, "dropped_"),
        ),
        Equation(
            "views: sent = weighed + lost + outstanding",
            views.get("sent", 0),
            views.get("weighed", 0) + _sum(views, "lost_") + views.get("outstanding", 0),
        ),
        Equation(
            "tracks: opened = counted + discarded + open",
            tracks.get("opened", 0),
            tracks.get("counted", 0) + _sum(tracks, "discarded_") + tracks.get("open", 0),
        ),
    ]
    return equations


def ledger_equations(
    roles: Mapping[str, int], *, track_entries: int, pending: int, tubers: int, groups: int
) -> list[Equation]:
    """The aggregator's own laws: every track of a log went somewhere, every tuber came from tracks.

    Args:
        roles: observations by role.
        track_entries: entries that hold a track; pending: of those, not yet in a tuber.
        tubers: rows of tubers; groups: different tubers that tracks were counted for.
    """
    return [
        Equation(
            "tracks in logs = counted + foreign + late duplicates + repeats + pending",
            track_entries,
            sum(roles.values()) + pending,
        ),
        Equation("tubers = tubers that tracks were counted for", tubers, groups),
    ]


def _sum(sheet: Mapping[str, int], prefix: str) -> int:
    return sum(n for key, n in sheet.items() if key.startswith(prefix))
