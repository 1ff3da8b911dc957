"""A made-up belt: tubers with places and weights, and the logs that cameras over it would send. Seeded, no pixels."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from conveyor.messages import Mark, Track, TrackEntry, WeighedView
from conveyor.messages.tracks import CARRIED

SPEED_MPS = 0.3
FPS = 30.0
CLOCK_S = 10.0
"""What the cameras' clocks say when the story begins; frames are numbered from their zero."""


@dataclass(frozen=True)
class Stop:
    """The belt stands from `at_s` on, `for_s` long."""

    at_s: float
    for_s: float

    def stood_s(self, at_s: float) -> float:
        """For how long it has stood by then."""
        return float(np.clip(at_s - self.at_s, 0.0, self.for_s))


NEVER = Stop(0.0, 0.0)


@dataclass(frozen=True)
class Camera:
    """A camera: the lane it sees (belt y, metres), where its centre row lies, its travel's zero and drift; `misses`: it
    sees bare belt while that stands, and takes it to run on."""

    name: str
    low_y_m: float
    high_y_m: float
    x_m: float
    zero_m: float = 0.0
    drift: float = 0.0
    misses: Stop | None = None


@dataclass(frozen=True)
class Tuber:
    x_m: float
    y_m: float
    weight_g: float


@dataclass(frozen=True)
class Story:
    """Who passed, who looked, and what each camera's log says (`logs[camera][n - 1]` is entry n)."""

    run: str
    tubers: tuple[Tuber, ...]
    cameras: tuple[Camera, ...]
    logs: dict[str, list[TrackEntry]]

    @property
    def names(self) -> list[str]:
        return [camera.name for camera in self.cameras]

    def seen(self) -> list[Tuber]:
        """Tubers that some camera's lane holds."""
        return [t for t in self.tubers if any(c.low_y_m <= t.y_m <= c.high_y_m for c in self.cameras)]

    def in_run(self, run: str) -> Story:
        """The same story under another run id."""
        return replace(
            self, run=run, logs={n: [_renamed(e, self.run, run) for e in log] for n, log in self.logs.items()}
        )


def _renamed(entry: TrackEntry, old: str, new: str) -> TrackEntry:
    track = entry.track
    if track is None:
        return replace(entry, run=new)
    return replace(entry, run=new, track=replace(track, track_id=track.track_id.replace(old, new, 1)))


def scatter(rng: np.random.Generator, n: int, *, apart_m: float, length_m: float, width_m: float = 0.4) -> list[Tuber]:
    """At most `n` tubers no nearer to each other than `apart_m`."""
    tubers: list[Tuber] = []
    for _ in range(40 * n):
        x, y = -rng.uniform(0.05, length_m), rng.uniform(-width_m / 2, width_m / 2)
        if all(np.hypot(x - t.x_m, y - t.y_m) >= apart_m for t in tubers):
            tubers.append(Tuber(float(x), float(y), float(rng.uniform(40, 400))))
        if len(tubers) == n:
            break
    return tubers


def tell(
    seed: int,
    *,
    run: str = "story",
    n: int = 12,
    cameras: int = 2,
    apart_m: float = 0.06,
    length_m: float = 1.2,
    noise_mm: float = 3.0,
    estimated: bool = False,
    told_to: Collection[str] = (),
    split: float = 0.05,
    spread_m: float = 0.1,
    stop: Stop = NEVER,
) -> Story:
    """A belt with up to `n` tubers under 1 to 3 cameras whose lanes overlap.

    Args:
        apart_m: no two tubers nearer than this.
        noise_mm: sd of a camera's place of a tuber.
        estimated: no encoder; each camera has its own zero and up to 1 % drift.
        told_to: names of cameras that have one all the same.
        split: share of tracks told in two halves that never met in a frame.
        spread_m: cameras hang so far up and down the belt from its middle, at most.
        stop: the belt stands for a while, and the first camera sees none of the load then.
    """
    rng = np.random.default_rng(seed)
    tubers = scatter(rng, n, apart_m=apart_m, length_m=length_m)
    lanes = {1: [(-1, 1)], 2: [(-1, 0.08), (-0.08, 1)], 3: [(-1, 0.08), (-0.08, 1), (-1, 1)]}[cameras]
    estimates = [estimated and f"cam{i}" not in told_to for i in range(len(lanes))]
    looking = tuple(
        Camera(
            f"cam{i}",
            *lane,
            x_m=float(rng.uniform(-spread_m, spread_m)),
            zero_m=float(rng.uniform(-0.5, 0.5)) if estimates[i] else 0.0,
            drift=float(rng.uniform(-0.01, 0.01)) if estimates[i] else 0.0,
            misses=stop if i == 0 and estimates[i] else None,
        )
        for i, lane in enumerate(lanes)
    )
    if stop.for_s:
        tubers = [t for t in tubers if t.y_m > looking[0].high_y_m or abs(_runs_s(looking[0], t) - stop.at_s) > 1.0]
    logs = {
        c.name: _log(rng, run, c, tubers, noise_mm / 1000, length_m, without, split, stop)
        for c, without in zip(looking, estimates, strict=True)
    }
    return Story(run, tuple(tubers), looking, logs)


def _log(
    rng: np.random.Generator,
    run: str,
    camera: Camera,
    tubers: list[Tuber],
    noise_m: float,
    length_m: float,
    estimated: bool,
    split: float,
    stop: Stop,
) -> list[TrackEntry]:
    """Tracks and marks in an order the segmenter may write them: a track some time after its crossing, marks honest."""
    facts: list[tuple[float, Track | Mark]] = []
    for tuber in tubers:
        if not camera.low_y_m <= tuber.y_m <= camera.high_y_m:
            continue
        runs_s = _runs_s(camera, tuber)
        crossed_s = runs_s + (stop.for_s if runs_s > stop.at_s else 0.0)
        parts = 2 if rng.random() < split else 1
        for part in range(parts):
            dx, dy = np.clip(rng.normal(0, noise_m, 2), -3 * noise_m, 3 * noise_m)
            track = _track(run, camera, tuber, crossed_s, float(dx), float(dy), estimated, part, parts, rng, stop)
            facts.append((crossed_s + rng.uniform(0.2, 1.0), track))
    end_s = (length_m + 0.3) / SPEED_MPS + 1.2 + stop.for_s
    facts += [
        (float(at_s), _mark(camera, float(at_s), estimated, stop, final=False)) for at_s in np.arange(0.5, end_s, 0.5)
    ]
    facts.sort(key=lambda fact: fact[0])
    facts.append(
        (end_s, _mark(camera, end_s, estimated, stop, final=True, tracks=sum(isinstance(f, Track) for _, f in facts)))
    )
    return [
        TrackEntry(
            camera.name,
            run,
            n,
            track=fact if isinstance(fact, Track) else None,
            mark=fact if isinstance(fact, Mark) else None,
        )
        for n, (_, fact) in enumerate(facts, start=1)
    ]


def _runs_s(camera: Camera, tuber: Tuber) -> float:
    """For how long the belt has run when the tuber crosses."""
    return (camera.x_m - tuber.x_m) / SPEED_MPS


def _moved(camera: Camera, at_s: float, stop: Stop) -> float:
    """How far the belt has moved, as the camera has it but for its drift."""
    return SPEED_MPS * (at_s - (0.0 if camera.misses else stop.stood_s(at_s)))


def _travel(camera: Camera, at_s: float, stop: Stop) -> float:
    return camera.zero_m + (1 + camera.drift) * _moved(camera, at_s, stop)


def _track(
    run: str,
    camera: Camera,
    tuber: Tuber,
    crossed_s: float,
    dx_m: float,
    dy_m: float,
    estimated: bool,
    part: int,
    parts: int,
    rng: np.random.Generator,
    stop: Stop,
) -> Track:
    first = round((CLOCK_S + crossed_s) * FPS) - 14
    first_seq, last_seq = [(first, first + 28), (first, first + 13), (first + 14, first + 28)][part + (parts > 1)]
    track_id = f"{run}/{camera.name}/{first_seq}-{round(-tuber.x_m * 1e4)}"
    views = tuple(
        WeighedView(
            f"{track_id}/{seq}",
            seq,
            weight := float(tuber.weight_g * rng.normal(1, 0.05)),
            0.85 * weight,
            1.2 * weight,
            "pointraft",
            "m",
            (),
        )
        for seq in (first_seq + 3, first_seq + 6, first_seq + 9)
    )
    return Track(
        track_id=track_id,
        crossed_ns=round((CLOCK_S + crossed_s) * 1e9),
        crossed_x_m=camera.x_m + dx_m,
        y_m=tuber.y_m + dy_m,
        travel_m=_travel(camera, crossed_s, stop),
        travel_estimated=estimated,
        frames=last_seq - first_seq + 1,
        first_seq=first_seq,
        last_seq=last_seq,
        length_mm=70.0,
        width_mm=55.0,
        height_mm=45.0,
        visible_volume_ml=tuber.weight_g,
        whole=True,
        views_sent=3,
        views=views,
        views_lost={},
    )


def _mark(camera: Camera, at_s: float, estimated: bool, stop: Stop, *, final: bool, tracks: int = 0) -> Mark:
    """Tracks come up to 1 s after their crossing: what crossed before that is in the log."""
    complete_s = at_s - 1.05
    frames = round(at_s * FPS)
    carried_ms = round(1000 * camera.misses.stood_s(at_s)) if camera.misses else 0
    carried = {CARRIED: carried_ms} if carried_ms else {}
    return Mark(
        captured_ns=round((CLOCK_S + at_s) * 1e9),
        travel_m=_travel(camera, at_s, stop),
        travel_estimated=estimated,
        complete_ns=round((CLOCK_S + (at_s if final else complete_s)) * 1e9),
        complete_place_x_m=camera.x_m - _travel(camera, complete_s, stop) + 0.012,
        final=final,
        looked_at_m=_moved(camera, at_s, stop),
        travelled_m=_moved(camera, at_s, stop),
        frames={"published": frames, "received": frames, "processed": frames, "gaps": 0} | carried,
        views={"sent": 3 * tracks, "weighed": 3 * tracks, "outstanding": 0},
        tracks={"opened": tracks, "counted": tracks, "open": 0},
    )
