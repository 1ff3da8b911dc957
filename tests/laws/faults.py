"""What goes wrong in a history: links that lose, double, delay and reorder; processes that die between two writes."""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")


class Died(BaseException):
    """The process is gone, here and now."""


@dataclass(slots=True)
class Fuse:
    """Burns down by one at each write of a process, and kills it when it reaches its end."""

    left: int | None = None

    def burn(self, what: str = "") -> None:
        """Called before each write."""
        if self.left is not None:
            self.left -= 1
            if self.left < 0:
                self.left = None
                raise Died(what)


@dataclass(slots=True)
class Faults:
    """How bad the links are now: shares of messages dropped and duplicated, longest delay, everything cut."""

    drop: float = 0.0
    duplicate: float = 0.0
    delay_s: float = 0.0
    cut: bool = False


class Link(Generic[T]):
    """A one-way link: what is put in comes out later, twice, out of order or never, as its seed and faults say."""

    def __init__(self, seed: int, faults: Faults) -> None:
        self._random = random.Random(seed)
        self._faults = faults
        self._flying: list[tuple[float, T]] = []

    def put(self, item: T, now_s: float) -> None:
        faults = self._faults
        copies = 1 + (self._random.random() < faults.duplicate)
        for _ in range(copies):
            if not faults.cut and self._random.random() >= faults.drop:
                self._flying.append((now_s + self._random.random() * faults.delay_s, item))

    def take(self, now_s: float) -> list[T]:
        if not self._flying:
            return []
        here = sorted((entry for entry in self._flying if entry[0] <= now_s), key=lambda entry: entry[0])
        if here:
            self._flying = [entry for entry in self._flying if entry[0] > now_s]
        return [item for _, item in here]
