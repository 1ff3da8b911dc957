"""What goes wrong with a camera, by name: frames lost or sent twice, a picture that stands still, clock jumps, dirt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from conveyor.errors import InputError

FAULTS = ("dropped", "duplicated", "frozen", "clock-jump", "dirty-lens")
"""Those of a camera; `worse` has those of the picture, the belt and the tubers."""
DIRT_SPOTS, DIRT_RADIUS = 5, (0.008, 0.03)
DROPPED_SHARE = 0.10
DUPLICATED_SHARE = 0.04
FROZEN_S = 0.7
CLOCK_JUMP_NS = 45_000_000_000


@dataclass(frozen=True, slots=True)
class FaultPlan:
    """The faults of one camera's recording.

    Attributes:
        missing: numbers of frames that never arrive.
        repeats: number of a frame that is its predecessor once more, with the same capture time.
        frozen: number of a frame -> number of the one whose picture it shows, while time and travel go on.
        dirt: spots on the lens, (u, v) in shares of the image and radius in shares of its width.
        jump_from, jump_back: frames numbered in [from, back) carry a clock that is 45 s ahead.
    """

    missing: frozenset[int] = frozenset()
    repeats: frozenset[int] = frozenset()
    frozen: tuple[tuple[int, int], ...] = ()
    jump_from: int | None = None
    jump_back: int | None = None
    dirt: tuple[tuple[float, float, float], ...] = ()

    def time_of(self, seq: int) -> int:
        """Number of the frame whose capture time and travel frame `seq` carries."""
        return seq - 1 if seq in self.repeats else seq

    def picture_of(self, seq: int) -> int:
        """Number of the frame whose picture frame `seq` shows."""
        return dict(self.frozen).get(seq, self.time_of(seq))

    def clock_shift_ns(self, seq: int) -> int:
        """What the camera's clock is ahead in frame `seq`, nanoseconds."""
        jumped = self.jump_from is not None and self.jump_back is not None and self.jump_from <= seq < self.jump_back
        return CLOCK_JUMP_NS if jumped else 0


def check_faults(names: tuple[str, ...]) -> tuple[str, ...]:
    """The names, or an error that lists the known ones; 'clock jump' and 'clock_jump' are 'clock-jump'."""
    from camera_sim.sim.worse import NOISE, WORLD

    known = (*FAULTS, *NOISE, *WORLD)
    plain = tuple(name.strip().lower().replace(" ", "-").replace("_", "-") for name in names)
    for name, given in zip(plain, names, strict=True):
        if name not in known:
            raise InputError(f"--inject {given} is unknown; known: {', '.join(known)}")
    return plain


def plan_faults(rng: Generator, *, frames: int, fps: float, names: tuple[str, ...], dropped: float) -> FaultPlan:
    """Faults of the given names over a recording of `frames` frames; `dropped` is the scene's own share."""
    share = max(dropped, DROPPED_SHARE if "dropped" in names else 0.0)
    missing = _missing(rng, frames, share)
    repeats: frozenset[int] = frozenset()
    frozen: tuple[tuple[int, int], ...] = ()
    jump: tuple[int | None, int | None] = (None, None)
    if "duplicated" in names and frames > 3:
        chosen = rng.choice(np.arange(2, frames), max(1, int(DUPLICATED_SHARE * frames)), replace=False)
        repeats = frozenset(int(seq) for seq in chosen) - missing
    if "frozen" in names and frames > 6:
        length = min(max(2, int(FROZEN_S * fps)), frames // 3)
        start = int(rng.integers(frames // 4, frames // 2 + 1))
        frozen = tuple((seq, start) for seq in range(start + 1, start + 1 + length))
    if "clock-jump" in names and frames > 6:
        jump = (frames // 3, 2 * frames // 3)
    dirt: list[tuple[float, float, float]] = []
    if "dirty-lens" in names:
        dirt = [(float(rng.random()), float(rng.random()), float(rng.uniform(*DIRT_RADIUS))) for _ in range(DIRT_SPOTS)]
    return FaultPlan(missing, repeats, frozen, *jump, tuple(dirt))


def _missing(rng: Generator, frames: int, share: float) -> frozenset[int]:
    """Numbers that never arrive: half of the frames lost alone, half in bursts of five; not the first or the last."""
    missing: set[int] = set()
    while frames > 2 and len(missing) < share * frames:
        start = int(rng.integers(1, max(2, frames - 6)))
        missing |= set(range(start, min(start + (5 if rng.random() < 1 / 6 else 1), frames - 1)))
    return frozenset(missing)
