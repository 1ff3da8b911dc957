"""Sums over the committed tubers of a load, carried along: the millionth tuber costs what the first one did."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

from aggregator.calibration.sensitivity import tuber_g_per_mm
from aggregator.core.foreign import ForeignBody, ForeignSums
from aggregator.core.height_sums import HeightSums
from aggregator.core.layers import LayerSums
from aggregator.core.size_bins import SizeBins
from conveyor.camera_flags import BELT_DISTANCE, CAMERA_NOISE, CAMERA_UNLIKE, RODS_UNSEEN, belt_off_mm
from conveyor.messages import Tuber
from conveyor.statistics import NORMAL_90

UNLIKE = frozenset((CAMERA_NOISE, CAMERA_UNLIKE, BELT_DISTANCE))
"""Flags of a tuber whose camera, or its distance, is unlike those that the weights were trained for."""
RATE_WINDOW_S = 10.0
RATE_TUBERS = 1000
QUIET_S = 15.0
"""Without a tuber for so long none passes; they are committed some seconds after they crossed."""
HISTOGRAM_CLASSES = 64
"""The last class takes everything heavier."""


class CameraDoubt(NamedTuple):
    """What is doubtful of the cameras that saw a load.

    `unlike_share`: of its weight, seen by cameras with flags of `UNLIKE`. `off_mm`: how far the belt was seen off its
    calibration with no gauge to say why, in the mean of its weight. `ungauged_share`: of its weight, seen by cameras
    that did not find the rods that are their gauge.
    """

    unlike_share: float
    off_mm: float
    ungauged_share: float


@dataclass(slots=True)
class LoadSums:
    """Sums over committed tubers; the order of `add` changes nothing but the last digits.

    `weighed` maps (method, model) to the number of tubers and the sum of their weights, grams. By `per_mm_g` that sum
    grows with each millimetre that all of them lie lower. `noisy_g` is the part of it with flags of `UNLIKE`;
    `off_g_mm` its sum times the millimetres by which the belt was seen off its calibration, with no gauge to say why;
    `ungauged_g` the part of it of cameras that did not find the rods that are their gauge. `heights` is None where some
    of the tubers were summed up by a version that kept no heights.
    """

    histogram_step_g: float
    count: int = 0
    weighed: dict[tuple[str, str], tuple[int, float]] = field(default_factory=dict)
    low_variance_g2: float = 0.0
    high_variance_g2: float = 0.0
    squares_g2: float = 0.0
    per_mm_g: float = 0.0
    noisy_g: float = 0.0
    off_g_mm: float = 0.0
    ungauged_g: float = 0.0
    seen_by: Counter[frozenset[str]] = field(default_factory=Counter)
    merged: int = 0
    late: int = 0
    classes: list[int] = field(default_factory=list)
    layers: LayerSums = field(default_factory=LayerSums)
    sizes: SizeBins = field(default_factory=SizeBins)
    foreign: ForeignSums = field(default_factory=ForeignSums)
    heights: HeightSums | None = field(default_factory=HeightSums)
    _recent_ns: deque[int] = field(default_factory=lambda: deque(maxlen=RATE_TUBERS))

    def add(self, tuber: Tuber | ForeignBody) -> None:
        """Count one committed tuber, or what is none."""
        if isinstance(tuber, ForeignBody):
            self.foreign.add(tuber)
            return
        self.count += 1
        n, weight_g = self.weighed.get((tuber.method, tuber.model), (0, 0.0))
        self.weighed[tuber.method, tuber.model] = (n + 1, weight_g + tuber.weight_g)
        self.low_variance_g2 += ((tuber.weight_g - tuber.low_g) / NORMAL_90) ** 2
        self.high_variance_g2 += ((tuber.high_g - tuber.weight_g) / NORMAL_90) ** 2
        self.squares_g2 += tuber.weight_g**2
        self.per_mm_g += tuber_g_per_mm(tuber)
        self.noisy_g += tuber.weight_g if UNLIKE.intersection(tuber.flags) else 0.0
        self.off_g_mm += tuber.weight_g * belt_off_mm(tuber.flags)
        self.ungauged_g += tuber.weight_g if RODS_UNSEEN in tuber.flags else 0.0
        self.seen_by[frozenset(tuber.cameras)] += 1
        self.merged += len(tuber.tracks) > 1
        self.late += "late" in tuber.flags
        self.layers.add(tuber)
        self._put(int(max(tuber.weight_g, 0.0) / self.histogram_step_g), 1)
        self.sizes.add(tuber)
        self.foreign.add_tuber(tuber)
        if self.heights is not None:
            self.heights.add(tuber)
        self.passed(tuber.crossed_ns)

    def _put(self, bin_: int, n: int) -> None:
        """Count `n` tubers of a weight class."""
        bin_ = min(bin_, HISTOGRAM_CLASSES - 1)
        self.classes += [0] * (bin_ + 1 - len(self.classes))
        self.classes[bin_] += n

    def take(self, other: Self) -> None:
        """Add what `other` counted; its classes go where their middles lie, if they are of another width."""
        self.count += other.count
        for key, (n, weight_g) in other.weighed.items():
            had_n, had_g = self.weighed.get(key, (0, 0.0))
            self.weighed[key] = (had_n + n, had_g + weight_g)
        self.low_variance_g2 += other.low_variance_g2
        self.high_variance_g2 += other.high_variance_g2
        self.squares_g2 += other.squares_g2
        self.per_mm_g += other.per_mm_g
        self.seen_by.update(other.seen_by)
        self.merged += other.merged
        self.late += other.late
        self.layers.take(other.layers)
        self.noisy_g += other.noisy_g
        self.off_g_mm += other.off_g_mm
        self.ungauged_g += other.ungauged_g
        self.sizes.take(other.sizes)
        self.foreign.take(other.foreign)
        if self.heights is None or other.heights is None:
            self.heights = None
        else:
            self.heights.take(other.heights)
        for at, n in enumerate(other.classes):
            self._put(int((at + 0.5) * other.histogram_step_g / self.histogram_step_g), n)

    def copy(self) -> Self:
        """The same sums, on their own from now on; the rate begins again."""
        fresh = type(self)(self.histogram_step_g)
        fresh.take(self)
        return fresh

    def passed(self, crossed_ns: int) -> None:
        """A tuber crossed the centre row: for the rate alone."""
        self._recent_ns.append(crossed_ns)
        newest = max(self._recent_ns[-1], self._recent_ns[0])
        while self._recent_ns and self._recent_ns[0] < newest - RATE_WINDOW_S * 1e9:
            self._recent_ns.popleft()

    @property
    def as_weighed_g(self) -> float:
        """Sum of the tubers' weights, grams."""
        return sum(weight_g for _, weight_g in self.weighed.values())

    def camera_doubt(self) -> CameraDoubt:
        """What is doubtful of its cameras; nothing where nothing was weighed."""
        whole_g = self.as_weighed_g
        if whole_g <= 0:
            return CameraDoubt(0.0, 0.0, 0.0)
        return CameraDoubt(self.noisy_g / whole_g, self.off_g_mm / whole_g, self.ungauged_g / whole_g)

    @property
    def mean_square_g2(self) -> float | None:
        """Mean square of a tuber's weight; None without tubers."""
        return self.squares_g2 / self.count if self.count else None

    def tubers_per_s(self, now_ns: int | None = None) -> float:
        """Tubers per second over the last stretch of the cameras' time, `now_ns` the newest of it: 0 on a belt that
        stands or is empty.
        """
        if len(self._recent_ns) < 2:
            return 0.0
        if now_ns is not None and now_ns - max(self._recent_ns) > QUIET_S * 1e9:
            return 0.0
        span_s = (max(self._recent_ns) - min(self._recent_ns)) / 1e9
        return (len(self._recent_ns) - 1) / span_s if span_s > 0 else 0.0

    def models(self) -> dict[str, int]:
        """Tubers by model; those without a weighed view have none."""
        return self._tally(1)

    def methods(self) -> dict[str, int]:
        """Tubers by method."""
        return self._tally(0)

    def _tally(self, at: int) -> dict[str, int]:
        found: dict[str, int] = {}
        for key, (n, _) in sorted(self.weighed.items()):
            if key[at]:
                found[key[at]] = found.get(key[at], 0) + n
        return found

    def plain(self) -> dict[str, Any]:
        """As JSON keeps it; every digit."""
        return {
            "histogram_step_g": self.histogram_step_g,
            "count": self.count,
            "weighed": [[*key, *sums] for key, sums in sorted(self.weighed.items())],
            "low_variance_g2": self.low_variance_g2,
            "high_variance_g2": self.high_variance_g2,
            "squares_g2": self.squares_g2,
            "per_mm_g": self.per_mm_g,
            "noisy_g": self.noisy_g,
            "off_g_mm": self.off_g_mm,
            "ungauged_g": self.ungauged_g,
            "seen_by": sorted([sorted(cameras), n] for cameras, n in self.seen_by.items()),
            "merged": self.merged,
            "late": self.late,
            "classes": self.classes,
            "layers": self.layers.plain(),
            "sizes": self.sizes.plain(),
            "foreign": self.foreign.plain(),
            "heights": None if self.heights is None else self.heights.plain(),
        }

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Self:
        """Back from `plain`; the rate begins again."""
        return cls(
            **{
                **plain,
                "weighed": {(method, model): (n, grams) for method, model, n, grams in plain["weighed"]},
                "foreign": ForeignSums.from_plain(plain.get("foreign", {})),
                "heights": None if plain.get("heights") is None else HeightSums.from_plain(plain["heights"]),
                "sizes": SizeBins.from_plain(plain.get("sizes", {})),
                "seen_by": Counter({frozenset(cameras): n for cameras, n in plain["seen_by"]}),
                "layers": LayerSums.from_plain(plain["layers"]) if "layers" in plain else LayerSums(),
            }
        )

    def same_as(self, other: Self) -> bool:
        """The two sums say the same, but for the last digits of sums of floats, and heights where one has none."""
        mine, others = self.plain(), other.plain()
        if self.heights is None or other.heights is None:
            del mine["heights"], others["heights"]
        return _close(mine, others)


def _close(a: Any, b: Any) -> bool:
    if isinstance(a, float) or isinstance(b, float):
        return math.isclose(a, b, rel_tol=1e-9, abs_tol=1e-6)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(_close(a[name], b[name]) for name in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(_close(x, y) for x, y in zip(a, b, strict=True))
    return bool(a == b)
