"""What goes wrong in each of the disturbed live runs, drawn from one seed: every role, every kind, at every time."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from random import Random
from typing import Any

ROLES = ("camera", "segmenter", "regressor", "aggregator", "router")
FREEZES_S = (3.0, 12.0, 40.0)
KINDS = ("kill", *(f"freeze {seconds:g} s" for seconds in FREEZES_S))
WHENS = ("start", "early", "late", "end", "two at once")
BELTS = ("encoder", "no encoder", "no encoder", "two cameras")
ENDS = ("stopped", "by itself")


@dataclass(frozen=True, slots=True)
class Fault:
    """One process is killed, or stopped and let go on. `at_s` counts from the start of the line."""

    role: str
    kind: str
    at_s: float

    @property
    def freeze_s(self) -> float | None:
        """For how long it is stopped; None: it is killed."""
        return None if self.kind == "kill" else float(self.kind.split()[1])


@dataclass(frozen=True, slots=True)
class Case:
    """One disturbed run: what belt, how it ends, what goes wrong when."""

    number: int
    belt: str
    ends: str
    when: str
    faults: tuple[Fault, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def drawn_cases(seed: int, runs: int, *, over_s: float) -> list[Case]:
    """`runs` cases, every role, kind and time as often as the others, in an order of their own.

    Args:
        over_s: when the line is stopped, or its recording ends; seconds after its start.
    """
    random = Random(seed)
    plan = [(role, kind, when) for when in WHENS for kind in KINDS for role in ROLES]
    cases: list[Case] = []
    while len(cases) < runs:
        for role, kind, when in random.sample(plan, len(plan)):
            first = Fault(role, kind, _at_s(random, when, over_s))
            cases.append(
                Case(
                    number=len(cases) + 1,
                    belt=random.choice(BELTS),
                    ends=random.choice(ENDS),
                    when=when,
                    faults=(first, *_second(random, first, when, over_s)),
                )
            )
    return cases[:runs]


def _at_s(random: Random, when: str, over_s: float) -> float:
    low, high = {
        "start": (0.5, 15.0),
        "early": (15.0, 0.45 * over_s),
        "late": (0.45 * over_s, over_s - 12.0),
        "end": (over_s - 8.0, over_s - 0.2),
        "two at once": (3.0, over_s - 5.0),
    }[when]
    return round(random.uniform(low, high), 2)


def _second(random: Random, first: Fault, when: str, over_s: float) -> tuple[Fault, ...]:
    """Another one at the same moment; in one of three other runs at any time."""
    role = random.choice([role for role in ROLES if role != first.role])
    second = Fault(role, random.choice(KINDS), first.at_s)
    if when == "two at once":
        return (second,)
    if random.random() < 1 / 3:
        return (replace(second, at_s=round(random.uniform(0.5, over_s - 0.2), 2)),)
    return ()
