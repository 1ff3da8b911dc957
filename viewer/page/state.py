"""What the page knows of a line at one moment. Ages are seconds since the page itself heard of it, by its own clock."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from conveyor.messages import CameraInfo, Counters, Totals

STALE_S = 3.5
"""Every node reports once a second, the totals twice: after this silence a figure is old and is shown as old."""


@dataclass(frozen=True, slots=True)
class NodeState:
    """One process of the line.

    Attributes:
        report: its newest counters; None where only its token was seen.
        age_s: since that report arrived.
        alive: its liveliness token is there; gone_s: how long it has not been; None where it never was.
        there_s: for how long its token has been there without a pause.
        per_s: growth of each counter over the last seconds.
        growing_s: for how long each counter has been growing without a pause; those that rest are left out.
        resting_s: how long ago each counter grew last, or was first seen.
        lowest: the lowest value of each counter over the last seconds.
    """

    report: Counters | None
    age_s: float
    alive: bool
    gone_s: float | None = 0.0
    there_s: float = math.inf
    per_s: Mapping[str, float] = field(default_factory=dict)
    growing_s: Mapping[str, float] = field(default_factory=dict)
    resting_s: Mapping[str, float] = field(default_factory=dict)
    lowest: Mapping[str, float] = field(default_factory=dict)

    def count(self, name: str) -> int:
        """The count `name`; 0 where it never happened."""
        return self.report.count(name) if self.report else 0

    def level(self, name: str) -> float | None:
        """The gauge `name`, or None where the node does not tell."""
        return self.report.gauges.get(name) if self.report else None

    @property
    def away_s(self) -> float:
        """How long it has been gone."""
        return self.age_s if self.gone_s is None else self.gone_s

    @property
    def left(self) -> bool:
        """It was there and is no more, on purpose or not."""
        return self.state in ("gone", "ended")

    @property
    def state(self) -> str:
        """'ok', 'stalled', 'starting' (not ready yet), 'silent' (alive, but says nothing), 'ended' or 'gone'.

        Who came, or came back, a moment ago has not had the time to report: it is starting, not silent.
        """
        if not self.alive:
            if self.report is not None and self.report.status == "ended":
                return "ended"
            return "starting" if self.gone_s is None and self.age_s <= STALE_S else "gone"
        if self.report is None or self.age_s > STALE_S:
            return "silent" if min(self.age_s, self.there_s) > STALE_S else "starting"
        return self.report.status


@dataclass(frozen=True, slots=True)
class Flow:
    """What comes along now; None where that is not known."""

    tubers_per_min: float | None = None
    kg_per_min: float | None = None
    belt_m_per_s: float | None = None


@dataclass(frozen=True, slots=True)
class Rate:
    """What came along in the last minutes, in steps of `step_s` seconds, oldest first; None where nothing is known."""

    step_s: float
    tubers_per_min: tuple[float | None, ...]
    kg_per_min: tuple[float | None, ...]


WEIGHTS = ("weight_g", "low_g", "high_g")


@dataclass(frozen=True, slots=True)
class ToldLoad:
    """One load that was started, as the aggregator tells it: `weight_g` and its interval are estimated for all of its
    belt, as a scale would say it; None where none of it was seen. `net_g` and `gross_g` are what scales said, `refused`
    why that does not calibrate, `doubts` what speaks against it; `notes` what persons did (`by`, `text`).
    """

    number: int
    name: str
    field: str
    variety: str
    began_unix_s: float
    open: bool
    count: int
    weight_g: float | None
    low_g: float | None
    high_g: float | None
    coverage: float | None
    net_g: float | None
    gross_g: float | None
    refused: tuple[str, ...]
    notes: tuple[Mapping[str, str], ...] = ()
    doubts: tuple[str, ...] = ()

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> ToldLoad:
        """What the page shows of it; raises KeyError where an aggregator tells something else."""
        notes = tuple({"by": str(note["by"]), "text": str(note["text"])} for note in told.get("notes", ()))
        doubts = tuple(map(str, told.get("doubts", ())))  # a line of an earlier version tells none
        found = {each.name: told[each.name] for each in fields(cls) if each.name not in ("notes", "doubts")}
        seen = found["weight_g"] is not None and bool(found["count"] or found["coverage"] is not None)
        found |= {name: told[f"estimated_{name}"] if seen else None for name in WEIGHTS}
        return cls(**found, notes=notes, doubts=doubts)


@dataclass(frozen=True, slots=True)
class PastLoad:
    """One run of the ledger, as the aggregator tells it. `end`: 'cameras ended', 'stopped', 'goes on' or 'cut off'; ''
    where one of an earlier version does not tell."""

    run: str
    started_unix_s: float
    count: int
    weight_g: float | None
    low_g: float | None
    high_g: float | None
    coverage: float | None
    final: bool
    end: str = ""

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> PastLoad:
        """What the page shows of it, whatever else an aggregator of another version tells; raises TypeError where
        something is missing.
        """
        known = {each.name for each in fields(cls)}
        return cls(**{name: value for name, value in told.items() if name in known})


@dataclass(frozen=True, slots=True)
class LineState:
    """A line at one moment. `no_router` is the endpoint at which none answers; empty where there is a link.

    `loads` are the ledger's last runs, `told` the loads that were started, both newest first; `changed_s` is how long
    ago another load was open, or none; None where the page saw no change. `frame_s`: by camera, since its segmenter
    last told where a frame shows the belt; it tells ten times a second.
    """

    line: str
    no_router: str = ""
    heard_s: float | None = None
    totals: Totals | None = None
    totals_age_s: float = 0.0
    nodes: Mapping[str, NodeState] = field(default_factory=dict)
    cameras: Mapping[str, CameraInfo] = field(default_factory=dict)
    flow: Flow = field(default_factory=Flow)
    loads: tuple[PastLoad, ...] = ()
    told: tuple[ToldLoad, ...] = ()
    changed_s: float | None = None
    frame_s: Mapping[str, float] = field(default_factory=dict)
    rate: Rate | None = None

    @property
    def in_contact(self) -> bool:
        """Something was heard of the line just now, and it is not the link that went since."""
        return self.heard_s is not None and self.heard_s <= STALE_S and not self._cut_off

    @property
    def _cut_off(self) -> bool:
        """Every process went at once without a goodbye: so it looks where the router or the link to it went."""
        known = [node for node in self.nodes.values() if node.gone_s is not None]
        return len(known) > 1 and not any(node.alive for node in known) and any(n.state == "gone" for n in known)

    @property
    def final(self) -> bool:
        """The run is complete: its figures do not grow old."""
        return self.totals is not None and self.totals.final

    @property
    def stopped(self) -> bool:
        """The line was ended on purpose before its run was complete: ledger, segmenters and cameras said goodbye."""
        keeper, segmenters = self.role("aggregator"), self.role("segmenter")
        if self.final or not keeper or not segmenters or set(segmenters) != set(self.camera_names()):
            return False
        counting = (keeper, segmenters, self.role("camera"))
        return all(node.state == "ended" for nodes in counting for node in nodes.values())

    def role(self, role: str) -> dict[str, NodeState]:
        """The nodes of one role, by name."""
        head = f"{role}/"
        return {name.removeprefix(head): node for name, node in sorted(self.nodes.items()) if name.startswith(head)}

    def camera_names(self) -> list[str]:
        """Every camera that was told of."""
        told = set(self.totals.cameras) if self.totals else set()
        return sorted(told | set(self.cameras) | set(self.role("camera")) | set(self.role("segmenter")))
