"""What is no tuber: bodies made of refused tracks, counted once like tubers, and what all of a load come to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from aggregator.core.foreign_odds import OddsBins
from aggregator.core.merge import Group
from conveyor.messages import Tuber


@dataclass(frozen=True, slots=True)
class ForeignBody:
    """A clod, a stone ('lump') or haulm, merged over cameras by its place.

    `volume_ml` is what lies under its visible surface; `log_odds` of tuber against other, None where only its shape
    tells what it is.
    """

    body_id: int
    run: str
    crossed_ns: int
    place_x_m: float
    place_y_m: float
    kind: str
    length_mm: float
    width_mm: float
    height_mm: float
    volume_ml: float
    cameras: tuple[str, ...]
    tracks: tuple[str, ...]
    log_odds: float | None = None


def is_foreign(group: Group) -> bool:
    """No camera took any track of the group for a tuber's."""
    return all(member.track.kind != "tuber" for member in group.members)


def make_body(group: Group, *, run: str, body_id: int) -> ForeignBody:
    """The body that all tracks of `group` saw; a clod or stone where any camera took it for one."""
    members = sorted(group.members, key=lambda member: (member.camera, member.track.first_seq, member.track.track_id))
    sized = [member.track for member in group.best]
    return ForeignBody(
        body_id=body_id,
        run=run,
        crossed_ns=min(member.track.crossed_ns for member in members),
        place_x_m=group.place_x_m,
        place_y_m=group.place_y_m,
        kind="lump" if any(member.track.kind == "lump" for member in members) else "haulm",
        length_mm=sum(track.length_mm for track in sized) / len(sized),
        width_mm=sum(track.width_mm for track in sized) / len(sized),
        height_mm=sum(track.height_mm for track in sized) / len(sized),
        volume_ml=sum(track.visible_volume_ml for track in sized) / len(sized),
        cameras=tuple(sorted({member.camera for member in members})),
        tracks=tuple(member.track.track_id for member in members),
        log_odds=mean_odds(group),
    )


def mean_odds(group: Group) -> float | None:
    """What the classifiers believe of a group, in the mean of those that were asked."""
    said = [member.track.log_odds for member in group.members if member.track.log_odds is not None]
    return sum(said) / len(said) if said else None


@dataclass(slots=True)
class ForeignSums:
    """Sums over bodies, and how sure the classifier was of them and of the tubers.

    Attributes:
        bodies: by kind, their number and the sum of their visible volumes, ml.
        unasked: bodies of which only the shape told what they are.
    """

    bodies: dict[str, list[float]] = field(default_factory=dict)
    unasked: int = 0
    odds: OddsBins = field(default_factory=OddsBins)

    def add(self, body: ForeignBody) -> None:
        """Count one body."""
        own = self.bodies.setdefault(body.kind, [0, 0.0])
        own[0] += 1
        own[1] += body.volume_ml
        if body.log_odds is None:
            self.unasked += 1
        else:
            self.odds.add_body(body.log_odds, body.volume_ml)

    def add_tuber(self, tuber: Tuber) -> None:
        """Take into account how sure the classifier was of a tuber."""
        if tuber.log_odds is not None:
            self.odds.add_tuber(tuber.log_odds, tuber.weight_g)

    def take(self, other: Self) -> None:
        """Add what `other` counted."""
        for kind, more in other.bodies.items():
            own = self.bodies.setdefault(kind, [0, 0.0])
            own[0] += more[0]
            own[1] += more[1]
        self.unasked += other.unasked
        self.odds.take(other.odds)

    @property
    def count(self) -> int:
        """Bodies of all kinds."""
        return int(sum(own[0] for own in self.bodies.values()))

    def plain(self) -> dict[str, Any]:
        """As JSON keeps it; empty where nothing foreign was seen and the classifier was not asked."""
        told = {
            "bodies": {kind: list(own) for kind, own in sorted(self.bodies.items())},
            "unasked": self.unasked,
            "odds": [[at, *own] for at, own in sorted(self.odds.bins.items())],
        }
        return told if self.bodies or self.odds.bins else {}

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Self:
        """Back from `plain`."""
        found = cls()
        found.bodies = {kind: list(own) for kind, own in plain.get("bodies", {}).items()}
        found.unasked = plain.get("unasked", 0)
        found.odds = OddsBins({row[0]: list(row[1:]) for row in plain.get("odds", [])})
        return found
