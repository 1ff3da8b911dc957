"""Does a process grow? A slope with its error after warm-up, over each life of a process and over all of them.

Samples of one life hang together, so they are averaged over half a minute first: the error of the slope would be told
far too small otherwise. Lives are pooled with a level of their own each: a restart takes nothing back.

What grows forever grows in the last half of the time too. A cache that is filled once, or what a link that was lost
needs to come back for the first time, does not: such a process is called settled, and the last half's slope is told.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

WARM_UP_S = 90.0
"""A process is measured from this age on, where nothing else is said: before, it loads, compiles and fills caches."""
BIN_S = 30.0
LEAST_BINS = 4
MEASURES = {"own_mib": 30.0, "descriptors": 6.0, "threads": 6.0}
"""What must not grow, and the growth per hour below which no one need care."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One process at one moment: seconds since the soak began and since the process did.

    `own_mib`: memory that it shares with no one; what forked processes share is in the resident memory of each.
    `share_mib`: its own and its share of what it shares (PSS), so that all together make up what the line takes.
    """

    at_s: float
    age_s: float
    pid: int
    own_mib: float
    share_mib: float
    descriptors: int
    threads: int


@dataclass(frozen=True, slots=True)
class Growth:
    """Growth per hour with its 95 % bounds; 'flat', 'grows', or 'unclear' where the bounds lie on both sides of it.

    `late`: where the whole is not flat, the same of the last halves of all lives; 'settled' where those are flat.
    """

    per_h: float
    low_per_h: float
    high_per_h: float
    measured_s: float
    verdict: str
    late: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class RoleVerdict:
    """One process by name: its lives, where it stood, and how each measure grew over all lives and within each."""

    name: str
    lives: int
    first: dict[str, float]
    last: dict[str, float]
    most: dict[str, float]
    pooled: dict[str, Growth | None]
    per_life: list[dict[str, Growth | None]]

    @property
    def word(self) -> str:
        """The worst of its verdicts."""
        return worst(growth.verdict for growth in self.pooled.values() if growth)

    def as_dict(self) -> dict[str, Any]:
        """For machines."""
        return {**asdict(self), "verdict": self.word}


def worst(words: Iterable[str]) -> str:
    """Of several verdicts the one that tells most against them; nothing told is 'unclear'."""
    said = set(words) or {"unclear"}
    return next(word for word in ("grows", "unclear", "settled", "flat") if word in said)


def role_verdict(name: str, samples: Sequence[Sample], *, warm_up_s: float = WARM_UP_S) -> RoleVerdict | None:
    """What the settled samples of a process say; None where it never lived long enough."""
    settled = [sample for sample in samples if sample.age_s >= warm_up_s]
    if not settled:
        return None
    lives: dict[int, list[Sample]] = defaultdict(list)
    for sample in settled:
        lives[sample.pid].append(sample)

    def measured(some: Sequence[Sequence[Sample]]) -> dict[str, Growth | None]:
        return {m: growth([[(s.at_s, getattr(s, m)) for s in life] for life in some], m) for m in MEASURES}

    def stood(pick: Any) -> dict[str, float]:
        return {m: float(pick([getattr(s, m) for s in settled])) for m in MEASURES}

    return RoleVerdict(
        name=name,
        lives=len({sample.pid for sample in samples}),
        first=stood(lambda values: values[0]),
        last=stood(lambda values: values[-1]),
        most=stood(max),
        pooled=measured(list(lives.values())),
        per_life=[measured([life]) for life in lives.values()],
    )


def line_verdict(samples: dict[str, Sequence[Sample]], *, warm_up_s: float = WARM_UP_S) -> Growth | None:
    """Growth of the memory of all processes together, at the moments at which all have settled."""
    at: dict[float, list[Sample]] = defaultdict(list)
    for some in samples.values():
        for sample in some:
            at[sample.at_s].append(sample)
    stretches: dict[tuple[int, ...], list[tuple[float, float]]] = defaultdict(list)
    for at_s, seen in sorted(at.items()):
        if len(seen) == len(samples) and all(sample.age_s >= warm_up_s for sample in seen):
            stretches[tuple(sorted(s.pid for s in seen))].append((at_s, sum(s.share_mib for s in seen)))
    return growth(list(stretches.values()), "own_mib")


def growth(lives: Sequence[Sequence[tuple[float, float]]], measure: str) -> Growth | None:
    """Common slope of several lives of (seconds, value), each with a level of its own; None where there is too little.

    Least squares on means over half a minute; bounds are 1.96 standard errors.
    """
    whole = _growth(lives, measure)
    if whole is None or whole.verdict == "flat":
        return whole
    late = _growth([_last_half(life) for life in lives], measure)
    if late is None:
        return whole
    told = (late.per_h, late.low_per_h, late.high_per_h)
    return replace(whole, late=told, verdict="settled" if late.verdict == "flat" else whole.verdict)


def _last_half(life: Sequence[tuple[float, float]]) -> Sequence[tuple[float, float]]:
    return [(at_s, value) for at_s, value in life if at_s >= (life[0][0] + life[-1][0]) / 2]


def _growth(lives: Sequence[Sequence[tuple[float, float]]], measure: str) -> Growth | None:
    xs, ys, levels, measured_s = [], [], 0, 0.0
    for life in lives:
        means = _binned(life)
        if len(means) < 2:
            continue
        mean_x = sum(x for x, _ in means) / len(means)
        mean_y = sum(y for _, y in means) / len(means)
        xs += [x - mean_x for x, _ in means]
        ys += [y - mean_y for _, y in means]
        levels += 1
        measured_s += means[-1][0] - means[0][0] + BIN_S
    freedom = len(xs) - levels - 1
    spread = sum(x * x for x in xs)
    if len(xs) < LEAST_BINS or freedom < 1 or spread == 0:
        return None
    slope = sum(x * y for x, y in zip(xs, ys, strict=True)) / spread
    residual = sum((y - slope * x) ** 2 for x, y in zip(xs, ys, strict=True))
    error = 1.96 * math.sqrt(residual / freedom / spread)
    low, high, limit = 3600 * (slope - error), 3600 * (slope + error), MEASURES[measure]
    verdict = "grows" if low > limit else "flat" if high <= limit else "unclear"
    return Growth(round(3600 * slope, 2), round(low, 2), round(high, 2), round(measured_s, 1), verdict)


def _binned(life: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    bins: dict[int, list[tuple[float, float]]] = defaultdict(list)
    for at_s, value in life:
        bins[int((at_s - life[0][0]) / BIN_S)].append((at_s, value))
    return [
        (sum(x for x, _ in some) / len(some), sum(y for _, y in some) / len(some)) for _, some in sorted(bins.items())
    ]
