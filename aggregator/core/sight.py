"""What one camera looked at of a load, along the belt, from its marks and from what the camera says it published.

`s` is the belt counted by the camera's own log: 0 at its first processed frame, then `Mark.travelled_m`.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import astuple, dataclass, field, replace
from itertools import pairwise
from typing import Any, Self

from aggregator.core.device import Device, with_newest
from conveyor.messages import CameraInfo, Mark
from conveyor.messages.tracks import UNFOLLOWED
from conveyor.ranges import FASTEST_MPS

PIECES = 256
"""Stretches of one looked-at share that are told apart per camera; beyond it the shortest neighbours become one."""

GAP_M = 0.25
"""A stretch that lacks more than this lacks it in one piece, at its end: a camera whose frames come no more sends no
mark before the next one does."""

NEWEST_PIECES = 192
"""Of them are left as they are where loads change on the way: coverage of the newest loads is told from them."""

SAMPLES = 96
"""Of (time, s) per camera, for the speed and for laying cameras side by side; beyond it older ones thin out."""

FIRST_SPEED_NS, LAST_SPEED_NS = 5_000_000_000, 2_000_000_000
"""Over so much of the marks the belt's first and last speed are taken. Without an encoder, and with few frames on a
busy machine, the first second of a belt is known to a quarter."""

WHOLE = 1e-6
"""Metres: less than this is rounding."""


@dataclass(slots=True)
class Published:
    """First and newest frame that the camera sent in this run, processed or not; travel only by an encoder."""

    first_ns: int | None = None
    first_travel_m: float | None = None
    last_ns: int | None = None
    last_travel_m: float | None = None
    frames: int = 0
    waits: bool = False
    live: bool = False
    lead_s: float = 0.0
    """Seconds from the load's beginning to the first frame of a live camera, by the aggregator's clock."""
    lead_m: float | None = None
    """How far the belt moved in them, by an encoder of its own; None where none told it."""
    devices: list[Device] = field(default_factory=list)
    """What sent them, oldest first: several where another one was hung up in mid-run."""

    def take(self, info: CameraInfo) -> None:
        """What a camera says of itself; one that was started again goes on from here."""
        self.waits, self.live = info.waits, info.live
        if info.first_captured_ns is not None:
            self.devices = with_newest(self.devices, Device.of(info))
        if info.first_seq is not None and info.last_seq is not None:
            self.frames = max(self.frames, info.last_seq - info.first_seq + 1)
        if info.first_captured_ns is not None and (self.first_ns is None or info.first_captured_ns < self.first_ns):
            self.first_ns, self.first_travel_m = info.first_captured_ns, info.first_travel_m
        if info.last_captured_ns is not None and (self.last_ns is None or info.last_captured_ns > self.last_ns):
            self.last_ns, self.last_travel_m = info.last_captured_ns, info.last_travel_m

    def plain(self) -> dict[str, Any]:
        """As JSON keeps it; without devices as a version before has it."""
        values = {name: getattr(self, name) for name in self.__slots__ if name != "devices"}
        return values | ({"devices": [astuple(device) for device in self.devices]} if self.devices else {})

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Self:
        """Back from `plain`."""
        return cls(**{**plain, "devices": [Device(*values) for values in plain.get("devices", ())]})


@dataclass(slots=True)
class CameraSight:
    """One camera's history. `pieces` are stretches (length, looked at), metres, one after the other from s = 0."""

    first_ns: int | None = None
    first_s: float = 0.0
    first_travel_m: float = 0.0
    """Travel at s = 0, as the camera knows it."""
    estimated: bool = False
    pieces: list[tuple[float, float]] = field(default_factory=list)
    curve: list[tuple[int, float]] = field(default_factory=list)
    line_m: list[float] = field(default_factory=list)
    """The line's travel at the first of these samples, where it is not the camera's own: it saw no load move for a
    while, and another camera did."""
    complete_ns: int = 0
    last_travel_m: float = 0.0
    final: bool = False
    processed: int = 0
    frames: dict[str, int] = field(default_factory=dict)
    published: Published = field(default_factory=Published)
    row_x_m: float | None = None
    """Where tubers cross the camera's centre row, belt coordinates; None before one did."""
    loads_change: bool = False
    ahead_ns: int = 0
    """What the camera's clock is ahead of the first camera's. All times here are its own."""

    @property
    def began_ns(self) -> int | None:
        """Its first processed frame, by the first camera's clock."""
        return None if self.first_ns is None else self.first_ns - self.ahead_ns

    def crossed(self, x_m: float) -> None:
        """A tuber's centre crossed the centre row there: each one counts for a twentieth."""
        self.row_x_m = x_m if self.row_x_m is None else self.row_x_m + 0.05 * (x_m - self.row_x_m)

    def marked(self, mark: Mark) -> None:
        """Take the next mark of the camera's log."""
        self.final, self.frames = mark.final, dict(mark.frames)
        self.processed = mark.frames.get("processed", 0)
        if mark.captured_ns == 0:
            return  # the end, by a process that never processed a frame
        s, looked = max(0.0, mark.travelled_m), max(0.0, mark.looked_at_m)
        if self.first_ns is None:
            self.first_ns, self.first_s = mark.captured_ns, s
            self.first_travel_m = mark.travel_m - s
        self.estimated = mark.travel_estimated
        self.last_travel_m, self.complete_ns = mark.travel_m, mark.complete_ns
        self._cut(s)
        length = s - self.length_m
        self._append(max(0.0, length), looked - self.looked_at_m)
        self._sample(mark.captured_ns, s)

    @property
    def length_m(self) -> float:
        """Belt in the log."""
        return sum(length for length, _ in self.pieces)

    @property
    def looked_at_m(self) -> float:
        """Of that, looked at."""
        return sum(looked for _, looked in self.pieces)

    @property
    def most_m(self) -> float | None:
        """Belt that can have passed at most, where it is not known how far it moved while load passed; else None."""
        unfollowed_ms = self.frames.get(UNFOLLOWED, 0) if self.estimated else 0
        return self.length_m + FASTEST_MPS * unfollowed_ms / 1000 if unfollowed_ms else None

    @property
    def last_ns(self) -> int:
        """Of the newest mark."""
        return self.curve[-1][0] if self.curve else 0

    def _cut(self, s: float) -> None:
        """A segmenter that was started again has lost what it had not logged: the belt from `s` on is told again."""
        surplus = self.length_m - s
        while surplus > 0 and self.pieces:
            length, looked = self.pieces.pop()
            if length > surplus:
                self.pieces.append((length - surplus, looked * (length - surplus) / length))
                return
            surplus -= length

    def _append(self, length: float, looked: float) -> None:
        """Add a stretch. Looked-at belt that is taken back, or that the stretch cannot hold, goes to those before."""
        fits = min(max(looked, 0.0), length)
        if fits > 0 and length - fits > GAP_M:
            self._append(fits, fits)
            self._append(length - fits, looked - fits)
            return
        if length > 0:
            whole = abs(fits - length) < WHOLE
            before = self.pieces[-1] if self.pieces else None
            if whole and before and abs(before[0] - before[1]) < WHOLE:
                self.pieces[-1] = (before[0] + length, before[1] + fits)
            else:
                self.pieces.append((length, fits))
        left = looked - fits
        for at in range(len(self.pieces) - 1, -1, -1):
            if abs(left) < WHOLE:
                break
            size, seen = self.pieces[at]
            now = min(max(seen + left, 0.0), size)
            left -= now - seen
            self.pieces[at] = (size, now)
        if len(self.pieces) > PIECES:
            self._coarsen()

    def _coarsen(self) -> None:
        older = self.pieces[:-NEWEST_PIECES] if self.loads_change else self.pieces
        sizes = [a[0] + b[0] for a, b in pairwise(older)]
        at = sizes.index(min(sizes))
        a, b = self.pieces[at : at + 2]
        self.pieces[at : at + 2] = [(a[0] + b[0], a[1] + b[1])]

    def _sample(self, t_ns: int, s: float) -> None:
        while self.curve and (self.curve[-1][0] >= t_ns or self.curve[-1][1] > s):
            self.curve.pop()
        del self.line_m[len(self.curve) :]
        self.curve.append((t_ns, s))
        if len(self.curve) > SAMPLES:
            half = SAMPLES // 2
            self.curve = self.curve[:half:2] + self.curve[half:]
            self.line_m = self.line_m[:half:2] + self.line_m[half:]

    def laid_m(self, s: float) -> float:
        """The line's travel when the camera's belt had come to `s`, where `line_m` tells it; beyond that with `s`."""
        known = self.curve[: len(self.line_m)]
        if s <= known[0][1]:  # where it began, though belt may have moved before it saw it do so
            return self.line_m[0] + s - known[0][1]
        right = bisect_right(known, s, key=lambda sample: sample[1])
        if right == len(known):
            return self.line_m[-1] + s - known[-1][1]
        (_, sa), (_, sb) = known[right - 1], known[right]
        la, lb = self.line_m[right - 1], self.line_m[right]
        return la + (lb - la) * (s - sa) / (sb - sa)

    def s_at(self, t_ns: int) -> float:
        """Belt at a capture time, metres; beyond the marks at the first or the last speed."""
        if not self.curve:
            return 0.0
        (t0, s0), (t1, s1) = self.curve[0], self.curve[-1]
        if t_ns <= t0:
            return s0 - (t0 - t_ns) / 1e9 * self.speed_mps(first=True)
        if t_ns >= t1:
            return s1 + (t_ns - t1) / 1e9 * self.speed_mps(first=False)
        right = bisect_right(self.curve, (t_ns, float("inf")))
        (ta, sa), (tb, sb) = self.curve[right - 1], self.curve[right]
        return sa + (sb - sa) * (t_ns - ta) / (tb - ta)

    def _ns_at(self, s: float) -> int:
        """The capture time at which the belt had come to `s`: `s_at` the other way round."""
        (t0, s0), (t1, s1) = self.curve[0], self.curve[-1]
        if not s0 < s < s1:
            speed = self.speed_mps(first=s <= s0)
            t, at = (t0, s0) if s <= s0 else (t1, s1)
            return t + round((s - at) / speed * 1e9) if speed > 0 else t
        right = next(n for n, (_, later) in enumerate(self.curve) if later >= s)
        (ta, sa), (tb, sb) = self.curve[right - 1], self.curve[right]
        return ta + round((tb - ta) * (s - sa) / (sb - sa))

    def speed_mps(self, *, first: bool) -> float:
        """Belt speed over the first 5 or the last 2 seconds and more of marks; 0 where there is but one."""
        if len(self.curve) < 2:
            return 0.0
        if first:
            (t0, s0), later = self.curve[0], self.curve[1:]
            # Bare belt without an encoder stands still until there is load to see it move by.
            t1, s1 = next((c for c in later if c[0] - t0 >= FIRST_SPEED_NS and c[1] > s0), later[-1])
        else:
            (t1, s1), earlier = self.curve[-1], self.curve[-2::-1]
            t0, s0 = next((c for c in earlier if t1 - c[0] >= LAST_SPEED_NS), earlier[-1])
        return max(0.0, (s1 - s0) / (t1 - t0) * 1e9)

    def missed_before_m(self) -> float:
        """Belt between the first frame published (or the load's beginning) and the first one processed."""
        if self.first_ns is None:
            return 0.0
        known, speed = self.published, self.speed_mps(first=True)
        missed_m = 0.0
        if not self.estimated and known.first_travel_m is not None:
            missed_m = self.first_travel_m - known.first_travel_m
        elif known.first_ns is not None:
            missed_m = (self.first_ns - known.first_ns) / 1e9 * speed - self.first_s
        lead_m = max(0.0, known.lead_s) * speed if known.lead_m is None else known.lead_m
        return max(0.0, missed_m) + lead_m

    def end_m(self, *, until_ns: int | None, ran_m: float | None = None) -> float:
        """Where the belt had come to, in terms of s: by the last frame published, by what an encoder of its own says
        that the belt ran since the newest mark (`ran_m`), or by the clock until `until_ns`.
        """
        known, s = self.published, self.length_m
        if not self.estimated and known.last_travel_m is not None:
            s = max(s, known.last_travel_m - self.first_travel_m)
        elif known.last_ns is not None and known.last_ns > self.last_ns:
            s = max(s, self.s_at(known.last_ns))
        if ran_m is not None:
            return max(s, self.length_m + ran_m)
        if until_ns is not None and until_ns > max(self.last_ns, known.last_ns or 0):
            newest_ns = max(self.last_ns, known.last_ns or 0)
            s += (until_ns - newest_ns) / 1e9 * self.speed_mps(first=False)
        return s

    def at_rest(self, *, until_ns: int | None, ran_m: float | None, waiting_m: float) -> CameraSight:
        """The same history as it is kept when the line is stopped: with how far the belt ran after the newest mark, and
        without the belt at its end whose tubers are in no ledger yet. Arguments as in `coverage.Moment`.
        """
        if self.final or not self.curve:
            return self
        end = self.end_m(until_ns=until_ns, ran_m=ran_m)
        told = replace(self.published)
        if end > self.length_m + WHOLE:
            told.last_ns = max(told.last_ns or 0, self._ns_at(end))
            if not self.estimated:
                told.last_travel_m = self.first_travel_m + end
        complete_ns = self.complete_ns
        if waiting_m > WHOLE:
            complete_ns = self._ns_at(max(0.0, min(self.length_m, self.s_at(complete_ns)) - waiting_m))
        return replace(self, published=told, complete_ns=complete_ns)

    def plain(self) -> dict[str, Any]:
        """As JSON keeps it."""
        not_needed = {name for name in ("ahead_ns", "line_m") if not getattr(self, name)}  # a version before reads it
        values = {name: getattr(self, name) for name in self.__slots__ if name not in {"published", *not_needed}}
        return {**values, "published": self.published.plain()}

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Self:
        """Back from `plain`."""
        return cls(
            **{
                **plain,
                "pieces": [(length, looked) for length, looked in plain["pieces"]],
                "curve": [(t_ns, s) for t_ns, s in plain["curve"]],
                "published": Published.from_plain(plain["published"]),
            }
        )
