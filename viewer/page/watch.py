"""One thread per line: observes it, notes when each figure was heard, and makes states. It asks for nothing that a node
would have to wait for, and goes on trying where a line cannot be reached.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Collection, Mapping, Set
from dataclasses import dataclass, field

from conveyor import topics
from conveyor.config import LinkConfig
from conveyor.delivery import KeptSubscriber, LatestSubscriber
from conveyor.errors import LinkError, TuberlineError
from conveyor.messages import CameraInfo, Counters, Position, Totals, Travel
from conveyor.observer import Observer
from viewer.page.camera_alarms import DEAD_S
from viewer.page.flow import BeltSpeed, LoadFlow, RateHistory, flow
from viewer.page.growth import Growth
from viewer.page.maps import FieldMaps
from viewer.page.pictures import Pictures, PictureWatch
from viewer.page.state import STALE_S, LineState, NodeState, PastLoad, ToldLoad

LOOK_EVERY_S = 0.25
TELL_EVERY_S = 1.0
CONNECT_WITHIN_S = 5.0
RETRY_S = 1.0
SAY_EVERY_S = 60.0
"""The log says so seldom that there is still no router: the page itself tells at once."""
TRAVEL_INBOX = 64
LOADS_EVERY_S = 20.0
LOADS_WITHIN_S = 1.0
LOADS = 12
TOLD = 24
MAX_NODES = 256
"""Processes that are remembered. Those of the config first, then those alive, then those heard of last."""
MAX_CAMERAS = 64
STILL_AFTER_S = 15.0
"""A look comes four times a second, and where it must connect or ask for loads within 6 s."""


@dataclass(slots=True)
class _NodeMemory:
    """What was heard of one node so far; `came_s`: when its token came, the last time that it did."""

    growth: Growth = field(default_factory=Growth)
    report: Counters | None = None
    heard_s: float = 0.0
    alive_s: float | None = None
    came_s: float | None = None


class LineWatch:
    """Tells `tell` a look about once a second, on its own thread, until stopped.

    Args:
        known: nodes ('role/name') of the line's config: they have a place, whatever others announce themselves.
        pictures: gets those of the cameras that somebody looks at; maps: where the machine is.
    """

    def __init__(
        self,
        link: LinkConfig,
        *,
        line: str,
        tell: Callable[[LineState], None],
        known: Collection[str] = (),
        pictures: Pictures | None = None,
        maps: FieldMaps | None = None,
    ) -> None:
        self._known = frozenset(known)
        self._pictures = pictures or Pictures()
        self._maps = maps or FieldMaps()
        self.line = line
        self._link = link.model_copy(update={"connect_timeout_s": CONNECT_WITHIN_S})
        self._tell = tell
        self._stop = threading.Event()
        self._log = logging.getLogger(f"page/{line}")
        self._nodes: dict[str, _NodeMemory] = {}
        self._totals: Totals | None = None
        self._totals_s: float | None = None
        self._load, self._belt, self._rate = LoadFlow(), BeltSpeed(), RateHistory()
        self._loads: tuple[PastLoad, ...] = ()
        self._told: tuple[ToldLoad, ...] = ()
        self._changed_s: float | None = None
        self._former_run = ""
        self._former: dict[str, Counters] = {}
        self._asked_s: float | None = None
        self._turned_s = time.monotonic()
        self._thread = threading.Thread(target=self._watch, name=f"watch-{line}", daemon=True)

    def start(self) -> None:
        """Begin to watch."""
        self._thread.start()

    def stop(self, within_s: float = 1.0) -> None:
        """End it; a session that does not close in time is left to the end of the process."""
        self._stop.set()
        self._thread.join(within_s)

    @property
    def moves(self) -> bool:
        """Its thread turns; else something that it called does not come back."""
        return time.monotonic() - self._turned_s < STILL_AFTER_S

    def ask_soon(self) -> None:
        """Something of the loads was changed: ask for them at the next look. From any thread."""
        self._asked_s = None

    def _watch(self) -> None:
        said, said_s = "", 0.0
        while not self._stop.is_set():
            self._turned_s = time.monotonic()
            try:
                with Observer(self._link, line=self.line, known=self._known) as observer:
                    self._log.info("watching line %s at %s", self.line, self._link.router)
                    said = ""
                    with PictureWatch(observer, self._pictures):
                        self._observe(observer)
            except TuberlineError as error:
                if str(error) != said or time.monotonic() - said_s >= SAY_EVERY_S:
                    said, said_s = str(error), time.monotonic()
                    self._log.warning("%s", error)
                self._tell(self._state_of({}, time.monotonic(), no_router=self._link.router))
            self._stop.wait(RETRY_S)

    def _observe(self, observer: Observer) -> None:
        infos = KeptSubscriber(
            observer,
            topics.CAMERA_INFO,
            CameraInfo,
            known=self._known,
            alive=observer.is_alive,
            most=MAX_CAMERAS,
            camera="*",
        )
        travels = LatestSubscriber(observer, topics.TRAVEL, Travel, capacity=TRAVEL_INBOX, source="*")
        places = LatestSubscriber(observer, topics.POSITION, Position, capacity=TRAVEL_INBOX, receiver="*")
        told_s = -TELL_EVERY_S
        signs: object = None
        while not self._stop.wait(LOOK_EVERY_S):
            now_s = self._turned_s = time.monotonic()
            while len(travels) and (travel := travels.get(0.0)) is not None:
                self._belt.add(travel, now_s)
            while len(places) and (place := places.get(0.0)) is not None:
                if place.quality > 0:
                    self._maps.add_place(self.line, lat_deg=place.lat_deg, lon_deg=place.lon_deg)
                else:
                    self._maps.no_fix(self.line)
            self._hear(observer, now_s)
            before, signs = signs, (observer.alive(), self._silent(now_s))
            if now_s - told_s >= TELL_EVERY_S or signs != before:  # who died is told at once
                told_s = now_s
                self._tell(self._state_of(self._by_camera(infos.latest()), now_s))
            if self._asked_s is None or now_s - self._asked_s >= LOADS_EVERY_S:
                self._ask_loads(observer, now_s)

    def _hear(self, observer: Observer, now_s: float) -> None:
        """Note what is new. A message is a new object, also where it says the same as the one before."""
        totals = observer.totals()
        if totals is not None and totals is not self._totals:
            if self._totals is not None and open_load(totals) != open_load(self._totals):
                self.ask_soon()
                another = totals.run != self._totals.run
                self._changed_s = None if another and totals.load is None else now_s  # a run is nothing to undo
            elif self._totals is not None and totals.calibrated_by != self._totals.calibrated_by:
                self.ask_soon()  # a ticket came: the loads weigh something else
            if self._totals is not None and totals.run != self._totals.run:
                self._begin(observer, self._totals.run)
            self._totals, self._totals_s = totals, now_s
            self._load.add(totals, now_s)
        alive = observer.alive()
        reports = {name: told for name, told in observer.nodes().items() if told is not self._former.get(name)}
        kept = remembered(
            {name: memory.heard_s for name, memory in self._nodes.items()},
            told={*reports, *alive},
            alive=alive,
            known=self._known,
        )
        for name in self._nodes.keys() - kept:
            del self._nodes[name]
        for name in sorted(kept & {*reports, *alive}):
            memory = self._nodes.setdefault(name, _NodeMemory(heard_s=now_s))
            if name not in alive:
                memory.came_s = None
            else:
                memory.alive_s = now_s
                memory.came_s = now_s if memory.came_s is None else memory.came_s
            report = reports.get(name)
            if report is not None and report is not memory.report:
                memory.report, memory.heard_s = report, now_s
                memory.growth.add(report, now_s)

    def _begin(self, observer: Observer, former: str) -> None:
        """Another run: its processes come one by one, and what is left of the run before says nothing of it."""
        self._maps.begin(self.line)
        self._former_run = former
        self._former = {name: told for name, told in observer.nodes().items() if told.run == former}
        for name in self._former:
            self._nodes.pop(name, None)

    def _silent(self, now_s: float) -> set[str]:
        """Who has not told where the belt is for as long as a camera that is dead."""
        return {source for source, since_s in self._belt.since_s(now_s).items() if since_s > DEAD_S}

    def _ask_loads(self, observer: Observer, now_s: float) -> None:
        """The ledger's last loads, from an aggregator that is there; an older one may not answer."""
        if "aggregator/aggregator" not in observer.alive():
            return
        self._asked_s = now_s
        try:
            found = observer.query(topics.QUERY_LOADS, parameters=f"limit={LOADS}", timeout_s=LOADS_WITHIN_S)
            self._loads = tuple(PastLoad.of(load) for load in found)
            told = observer.query(topics.QUERY_LOADS, parameters=f"limit={TOLD};what=loads", timeout_s=LOADS_WITHIN_S)
            self._told = tuple(ToldLoad.of(load) for load in told)
        except (LinkError, TypeError, KeyError, AttributeError) as error:
            self._log.debug("the ledger's loads: %s", error)

    def _by_camera(self, infos: Mapping[str, CameraInfo]) -> dict[str, CameraInfo]:
        """What cameras say of themselves; not what one says in another's name, nor how one ended in the run before."""
        own = {i.camera: i for key, i in infos.items() if topics.CAMERA_INFO.parts(key)["camera"] == i.camera}
        return {name: info for name, info in own.items() if info.run != self._former_run}

    def _state_of(self, cameras: dict[str, CameraInfo], now_s: float, *, no_router: str = "") -> LineState:
        heard = [memory.heard_s for memory in self._nodes.values() if memory.report is not None]
        heard += [] if self._totals_s is None else [self._totals_s]
        now = flow(self._load, self._belt, now_s)
        if heard and now_s - max(heard) <= STALE_S and self._totals is not None and not self._totals.final:
            self._rate.add(now, now_s)
        return LineState(
            line=self.line,
            no_router=no_router,
            heard_s=now_s - max(heard) if heard else None,
            totals=self._totals,
            totals_age_s=0.0 if self._totals_s is None else now_s - self._totals_s,
            nodes={name: _node(memory, now_s) for name, memory in self._nodes.items()},
            cameras=cameras,
            flow=now,
            rate=self._rate.rate(now_s),
            loads=self._loads,
            told=self._told,
            changed_s=None if self._changed_s is None else now_s - self._changed_s,
            frame_s=self._belt.since_s(now_s),
        )


def open_load(totals: Totals) -> tuple[str, int | None]:
    """Run and number of the load that is open."""
    return totals.run, None if totals.load is None else totals.load.number


def remembered(
    heard_s: Mapping[str, float], *, told: Set[str], alive: Set[str], known: Set[str], most: int = MAX_NODES
) -> set[str]:
    """Who of those remembered (`heard_s`: when) and those told of now keeps a place, or gets one.

    Those of the config first, then those alive, of both those remembered already; of those gone the last heard of.
    """
    everybody = {*heard_s, *told}
    if len(everybody) <= most:
        return everybody

    def order(name: str) -> tuple[bool, bool, bool, float, str]:
        return name not in known, name not in alive, name not in heard_s, -heard_s.get(name, 0.0), name

    return set(sorted(everybody, key=order)[:most])


def _node(memory: _NodeMemory, now_s: float) -> NodeState:
    alive = memory.alive_s == now_s
    return NodeState(
        report=memory.report,
        age_s=now_s - memory.heard_s,
        alive=alive,
        gone_s=None if memory.alive_s is None else now_s - memory.alive_s,
        there_s=0.0 if memory.came_s is None else now_s - memory.came_s,
        per_s=memory.growth.per_s(),
        growing_s=memory.growth.growing_s(now_s),
        resting_s=memory.growth.resting_s(now_s),
        lowest=memory.growth.lowest(),
    )
