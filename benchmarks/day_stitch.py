"""The belts of the simulated day laid end to end: one log of each camera, by the clock of the field.

A belt was rendered at the line's own speed. Its clock is stretched so that each tuber crosses when the field says,
in their order along the belt; the belt itself, frames, masks and weights are as they came.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.day_belts import RUN, Belt
from benchmarks.day_world import CAMERAS, LoadPlan
from conveyor.messages import Mark, Track, TrackEntry

BETWEEN_ROWS_M = 0.03
"""The cameras' centre rows lie at 0 and 0.06 m: tubers cross about here."""
LOOK_S = 2.0
"""A camera over a standing belt says so this long after its last tuber, and this long before the next one."""


@dataclass(slots=True)
class Reel:
    """Where the next belt begins: travel, and by camera the last frame, entry, sheets and lengths."""

    travel_m: float = 0.0
    seq: dict[str, int] = field(default_factory=lambda: dict.fromkeys(CAMERAS, 0))
    n: dict[str, int] = field(default_factory=lambda: dict.fromkeys(CAMERAS, 0))
    marks: dict[str, Mark] = field(default_factory=dict)

    def entry(self, camera: str, *, track: Track | None = None, mark: Mark | None = None) -> TrackEntry:
        """The next entry of a camera's log."""
        self.n[camera] += 1
        if mark is not None:
            self.marks[camera] = mark
        return TrackEntry(camera, RUN, self.n[camera], track=track, mark=mark)


@dataclass(frozen=True, slots=True)
class Clock:
    """From a belt's own time to the field's: `own_s` rising, `day_ns` at those moments."""

    own_s: NDArray[np.float64]
    day_s: NDArray[np.float64]
    start_ns: int

    @classmethod
    def of(cls, belt: Belt, load: LoadPlan) -> Clock:
        """The tubers along the belt cross at the field's times, in order; before and after it runs at its own speed."""
        times, travel = np.array(belt.frames[CAMERAS[0]]).T
        own_s = (times - times[0]) / 1e9
        crossing_m = np.sort([BETWEEN_ROWS_M - row["place_x_m"] for row in belt.truth["tubers"]])
        chosen = np.linspace(0, load.tubers - 1, len(crossing_m)).round().astype(int)
        day_s = (load.crossed_ns[chosen] - load.crossed_ns[0]) / 1e9
        at_s = np.interp(crossing_m, travel, own_s) + 1e-6 * np.arange(len(crossing_m))
        return cls(at_s, day_s + 1e-6 * np.arange(len(day_s)), int(load.crossed_ns[0]))

    def day_ns(self, own_ns: int, *, first_ns: int) -> int:
        """The field's time at a moment of the belt's own, whose first frame was taken at `first_ns`."""
        at_s = (own_ns - first_ns) / 1e9
        outside_s = min(at_s - self.own_s[0], 0.0) + max(at_s - self.own_s[-1], 0.0)
        within_s = float(np.interp(at_s, self.own_s, self.day_s))
        return self.start_ns + round((within_s + float(outside_s)) * 1e9)


def laid(belt: Belt, load: LoadPlan, reel: Reel, *, last: bool) -> Iterator[tuple[int, TrackEntry]]:
    """(when, entry) of both cameras over one belt, in the order of time; the reel moves on."""
    clock = Clock.of(belt, load)
    first_ns = belt.frames[CAMERAS[0]][0][0]
    found: list[tuple[int, str, Track | Mark]] = []
    for camera in CAMERAS:
        newest_ns = 0
        for entry in belt.logs[camera]:
            if entry.track is not None:
                found.append((newest_ns, camera, _track(entry.track, camera, reel, clock, first_ns)))
            elif entry.mark is not None:
                mark = _mark(entry.mark, reel.travel_m, clock, first_ns, last=last)
                mark = _added(mark, reel.marks.get(camera))
                newest_ns = mark.captured_ns
                found.append((newest_ns, camera, mark))
    found.sort(key=lambda row: row[0])
    for when_ns, camera, item in found:
        if isinstance(item, Mark):
            yield when_ns, reel.entry(camera, track=None, mark=item)
        else:
            yield when_ns, reel.entry(camera, track=item, mark=None)
    reel.travel_m += max(belt.frames[camera][-1][1] for camera in CAMERAS)
    for camera in CAMERAS:
        reel.seq[camera] += len(belt.frames[camera])


def standing(reel: Reel, at_ns: int) -> Iterator[tuple[int, TrackEntry]]:
    """Both cameras look at the belt that stands: a mark each, one frame on."""
    for camera in CAMERAS:
        mark = reel.marks[camera]
        frames = {name: n + (name in ("published", "received", "processed")) for name, n in mark.frames.items()}
        reel.seq[camera] += 1
        here = replace(
            mark,
            captured_ns=at_ns,
            complete_ns=at_ns,
            travel_m=reel.travel_m,
            complete_place_x_m=min(mark.complete_place_x_m, -reel.travel_m),
            looked_at_m=mark.looked_at_m + reel.travel_m - mark.travel_m,
            travelled_m=mark.travelled_m + reel.travel_m - mark.travel_m,
            frames=frames,
        )
        yield at_ns, reel.entry(camera, mark=here)


def _track(track: Track, camera: str, reel: Reel, clock: Clock, first_ns: int) -> Track:
    own_seq, number = track.track_id.rsplit("/", 1)[1].split("-")
    base = reel.seq[camera]
    track_id = f"{RUN}/{camera}/{int(own_seq) + base}-{number}"
    views = tuple(
        replace(view, seq=view.seq + base, view_id=view.view_id.replace(track.track_id, track_id, 1))
        for view in track.views
    )
    return replace(
        track,
        track_id=track_id,
        crossed_ns=clock.day_ns(track.crossed_ns, first_ns=first_ns),
        travel_m=track.travel_m + reel.travel_m,
        first_seq=track.first_seq + base,
        last_seq=track.last_seq + base,
        views=views,
    )


def _mark(mark: Mark, travel_m: float, clock: Clock, first_ns: int, *, last: bool) -> Mark:
    return replace(
        mark,
        captured_ns=clock.day_ns(mark.captured_ns, first_ns=first_ns),
        travel_m=mark.travel_m + travel_m,
        complete_ns=clock.day_ns(mark.complete_ns, first_ns=first_ns),
        complete_place_x_m=mark.complete_place_x_m - travel_m,
        final=mark.final and last,
    )


def _added(mark: Mark, base: Mark | None) -> Mark:
    """`mark` of a belt with all that came before it: sheets, lengths, and nothing that goes back."""
    if base is None:
        return mark
    travelled_m = mark.travel_m - base.travel_m
    return replace(
        mark,
        complete_ns=max(mark.complete_ns, base.complete_ns),
        complete_place_x_m=min(mark.complete_place_x_m, base.complete_place_x_m),
        # Up to its first frame on this belt the camera looked on at the end of the belt before.
        looked_at_m=base.looked_at_m + travelled_m - (mark.travelled_m - mark.looked_at_m),
        travelled_m=base.travelled_m + travelled_m,
        frames=_summed(mark.frames, base.frames),
        views=_summed(mark.views, base.views),
        tracks=_summed(mark.tracks, base.tracks),
    )


def _summed(sheet: Mapping[str, int], base: Mapping[str, int]) -> dict[str, int]:
    names = dict.fromkeys([*base, *sheet])
    return {name: base.get(name, 0) + sheet.get(name, 0) for name in names}
