"""One direction of an emulated link as a value of time: what enters when, what leaves when, what is lost and why.

No clock and no socket: times are given, randomness is seeded. `benchmarks.link_emulator` is the process around it.
"""

from __future__ import annotations

import random
from collections import deque
from dataclasses import asdict, dataclass

QUEUE_BYTES = 256 * 1024
MOST_UNDER_WAY_BYTES = 64 << 20
"""No link holds more than this, however fast and far: the emulator's own memory is bounded by it."""


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """What a link does to packets, in each of its two directions.

    Attributes:
        delay_s: from a packet's last bit on the wire to its arrival.
        jitter_s: the delay of each packet differs by up to this much, evenly, up or down. Order is kept.
        loss: share of the packets that vanish, independently; they take their time on the wire all the same.
        bits_per_s: rate of the wire, 0 without a limit.
        queue_bytes: what may wait for the wire; more is dropped at its tail, as a modem does.
        cut: nothing enters any more; what is under way arrives.
    """

    delay_s: float = 0.0
    jitter_s: float = 0.0
    loss: float = 0.0
    bits_per_s: float = 0.0
    queue_bytes: int = QUEUE_BYTES
    cut: bool = False

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if value < 0:
                raise ValueError(f"{name} = {value}: a link needs a value of at least 0")
        if self.loss > 1:
            raise ValueError(f"loss = {self.loss}: a share lies between 0 and 1")
        if self.jitter_s > self.delay_s:
            raise ValueError(f"jitter_s = {self.jitter_s} exceeds delay_s = {self.delay_s}: packets would arrive early")


@dataclass(slots=True)
class Counts:
    """What became of the packets of one direction: entered = forwarded + under way + the four losses."""

    entered: int = 0
    forwarded: int = 0
    forwarded_bytes: int = 0
    lost_loss: int = 0
    lost_queue: int = 0
    lost_cut: int = 0
    lost_far_end: int = 0

    @property
    def under_way(self) -> int:
        """Entered and neither arrived nor lost."""
        lost = self.lost_loss + self.lost_queue + self.lost_cut + self.lost_far_end
        return self.entered - self.forwarded - lost


class Wire:
    """Packets on their way in one direction. Times are seconds of any clock that does not go back."""

    def __init__(self, settings: LinkSettings, *, seed: int) -> None:
        self.settings = settings
        self.counts = Counts()
        self._random = random.Random(seed)
        self._under_way: deque[tuple[float, bytes]] = deque()
        self._under_way_bytes = 0
        self._free_s = 0.0
        self._last_due_s = 0.0

    def take(self, packet: bytes, now_s: float) -> None:
        """A packet enters: it is put under way, or lost with its reason."""
        self.counts.entered += 1
        link = self.settings
        if link.cut:
            self.counts.lost_cut += 1
            return
        if not self._has_room(len(packet), now_s):
            self.counts.lost_queue += 1
            return
        if link.bits_per_s:
            self._free_s = max(now_s, self._free_s) + 8 * len(packet) / link.bits_per_s
        else:
            self._free_s = now_s
        if self._random.random() < link.loss:
            self.counts.lost_loss += 1
            return
        due_s = self._free_s + link.delay_s + link.jitter_s * self._random.uniform(-1.0, 1.0)
        self._last_due_s = max(due_s, self._last_due_s)
        self._under_way.append((self._last_due_s, packet))
        self._under_way_bytes += len(packet)

    def due(self, now_s: float) -> list[bytes]:
        """The packets that have arrived by now, in order; the caller says whether each could be handed over."""
        arrived = []
        while self._under_way and self._under_way[0][0] <= now_s:
            packet = self._under_way.popleft()[1]
            self._under_way_bytes -= len(packet)
            arrived.append(packet)
        return arrived

    def handed_over(self, packet: bytes, *, taken: bool) -> None:
        """Book an arrived packet: the far end took it, or it did not."""
        if taken:
            self.counts.forwarded += 1
            self.counts.forwarded_bytes += len(packet)
        else:
            self.counts.lost_far_end += 1

    @property
    def next_due_s(self) -> float | None:
        """When the next packet arrives; None where none is under way."""
        return self._under_way[0][0] if self._under_way else None

    def _has_room(self, size: int, now_s: float) -> bool:
        backlog_bytes = max(0.0, self._free_s - now_s) * self.settings.bits_per_s / 8
        return backlog_bytes + size <= self.settings.queue_bytes and (
            self._under_way_bytes + size <= MOST_UNDER_WAY_BYTES
        )
