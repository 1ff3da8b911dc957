"""How the belt moves: travel over time for constant, changing and stop-and-go speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Profile = Literal["constant", "changing", "stop-and-go"]
STEP_S = 0.001


@dataclass(frozen=True, slots=True)
class BeltMotion:
    """Travel in metres every millisecond from time 0, never falling."""

    travel_m: NDArray[np.float64]

    @property
    def duration_s(self) -> float:
        """Time until the planned travel is done."""
        return (len(self.travel_m) - 1) * STEP_S

    def travel_at(self, time_s: float) -> float:
        """Travel at `time_s`, metres; before the start 0, after the end the whole."""
        return float(np.interp(time_s / STEP_S, np.arange(len(self.travel_m)), self.travel_m))


def plan_motion(
    rng: Generator, *, travel_m: float, speed_mps: float, profile: Profile, jitter: float = 1.0
) -> BeltMotion:
    """A belt that has moved `travel_m` at the end, with `jitter` times 1 % of smooth jitter in its speed."""
    longest_s = 6.0 * travel_m / speed_mps + 30.0
    time = np.arange(0.0, longest_s, STEP_S)
    phases = rng.uniform(0, 2 * np.pi, 3)
    swing = 1 + 0.007 * jitter * np.sin(2 * np.pi * 1.7 * time + phases[0])
    swing += 0.007 * jitter * np.sin(2 * np.pi * 0.37 * time + phases[1])
    speed = speed_mps * _profile(time, profile, float(phases[2])) * np.maximum(swing, 0.0)
    travel = np.concatenate([[0.0], np.cumsum(speed[:-1]) * STEP_S])
    end = int(np.searchsorted(travel, travel_m)) + 1
    return BeltMotion(travel[: min(end, len(travel))])


def _profile(time: NDArray[np.float64], profile: Profile, phase: float) -> NDArray[np.float64]:
    if profile == "changing":
        return np.asarray(1 + 0.35 * np.sin(2 * np.pi * time / 7.0 + phase) + 0.15 * np.sin(2 * np.pi * time / 2.3))
    if profile == "stop-and-go":
        at = time % 4.2  # 2.2 s of running, 0.4 s of braking, 1.2 s of standing, 0.4 s of starting
        return np.asarray(np.interp(at, [0.0, 2.2, 2.6, 3.8, 4.2], [1.0, 1.0, 0.0, 0.0, 1.0]))
    return np.ones_like(time)
