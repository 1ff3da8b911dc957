"""A belt that runs past cameras whose segmenters fail now and then: what they tell, and what they really looked at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from aggregator.core.sight import CameraSight
from conveyor.geometry import Intrinsics
from conveyor.messages import CameraInfo, Mark

FPS = 10.0
REACH_M = 0.3
START_NS = 1_760_000_000_000_000_000
LENS = Intrinsics(10, 10, 10.0, 10.0, 5.0, 5.0)


@dataclass(frozen=True)
class Outage:
    """Frames of these seconds are not processed."""

    from_s: float
    to_s: float


@dataclass
class Looking:
    """One camera's history: what the aggregator knows, and the truth as belt (from, to) that was looked at."""

    sight: CameraSight
    looked: list[tuple[float, float]] = field(default_factory=list)


def positions_m(rng: np.random.Generator, seconds: float, *, steady: bool) -> np.ndarray:
    """(frames,) float64 belt at each frame, metres: one speed, or stop and go."""
    n = int(seconds * FPS) + 1
    speed = np.full(n, rng.uniform(0.15, 0.6))
    if not steady:
        for _ in range(3):
            at = int(rng.integers(n))
            speed[at : at + int(rng.integers(5, 60))] = rng.choice([0.0, 0.3, 0.7])
    moved = speed / FPS
    moved[0] = 0.0
    return np.cumsum(moved)


def look(
    belt_m: np.ndarray,
    outages: Sequence[Outage],
    *,
    estimated: bool,
    final: bool,
    name: str = "a",
    zero_m: float = 0.0,
    told: bool = True,
) -> Looking:
    """A camera over `belt_m` that publishes every frame.

    Args:
        estimated: no encoder: the camera's travel begins with its first processed frame.
        final: its log ends with a final mark; else the line was stopped.
        zero_m: of the encoder. told: the camera's own word of what it published has arrived.
    """
    seen = [k for k in range(len(belt_m)) if not any(o.from_s <= k / FPS < o.to_s for o in outages)]
    own = Looking(CameraSight())
    travelled = looked = 0.0
    marked = -(10**9)
    for at, k in enumerate(seen):
        if at:
            before, now = belt_m[seen[at - 1]], belt_m[k]
            moved, part = now - before, min(now - before, REACH_M)
            travelled, looked = travelled + moved, looked + part
            own.looked += [(before, before + part / 2), (now - part / 2, now)] if moved > 0 else []
        last = k == seen[-1]
        if k - marked >= FPS or last:
            marked = k
            origin = belt_m[seen[0]] if estimated else -zero_m
            own.sight.marked(_mark(k, belt_m[k] - origin, estimated, final and last, looked, travelled, at + 1))
    if final and not seen:
        own.sight.marked(_mark(None, 0.0, estimated, True, 0.0, 0.0, 0))
    if told:
        own.sight.published.take(_info(name, belt_m, None if estimated else zero_m))
    return own


def _mark(
    k: int | None, travel_m: float, estimated: bool, final: bool, looked: float, travelled: float, n: int
) -> Mark:
    t_ns = 0 if k is None else START_NS + round(k / FPS * 1e9)
    return Mark(t_ns, travel_m, estimated, t_ns, -travel_m, final, looked, travelled, {"processed": n}, {}, {})


def _info(name: str, belt_m: np.ndarray, zero_m: float | None) -> CameraInfo:
    last = len(belt_m) - 1
    return CameraInfo(
        name, "r", "streaming", "test", FPS, False, LENS, 0.001, 0, last, last + 1, {},
        first_captured_ns=START_NS,
        first_travel_m=None if zero_m is None else float(belt_m[0]) + zero_m,
        last_captured_ns=START_NS + round(last / FPS * 1e9),
        last_travel_m=None if zero_m is None else float(belt_m[-1]) + zero_m,
    )  # fmt: skip


def some_outages(rng: np.random.Generator, seconds: float) -> list[Outage]:
    """A slow start, a freeze, a death near the end: each now and then."""
    found = []
    if rng.random() < 0.6:
        found.append(Outage(0.0, rng.uniform(0.1, 0.4) * seconds))
    for _ in range(int(rng.integers(0, 3))):
        at = rng.uniform(0, seconds)
        found.append(Outage(at, at + rng.uniform(0.3, 12.0)))
    if rng.random() < 0.4:
        found.append(Outage(rng.uniform(0.7, 0.95) * seconds, 10 * seconds))
    return found


def share_of(looked: Sequence[tuple[float, float]], belt_m: float, *, cells: int = 20_000) -> np.ndarray:
    """(cells,) bool: which of the belt's equal cells were looked at."""
    found = np.zeros(cells, bool)
    for a, b in looked:
        found[round(a / belt_m * cells) : round(b / belt_m * cells)] = True
    return found
