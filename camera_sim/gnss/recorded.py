"""Positions of a recording, back onto the line when the cameras that replay it have come to their times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from conveyor import topics
from conveyor.config import LineConfig
from conveyor.delivery import KeptSubscriber, ReliablePublisher
from conveyor.errors import InputError, UnsendableError
from conveyor.formats.positions import POSITIONS_FILE, read_positions
from conveyor.messages import CameraInfo, Position
from conveyor.node import Node

RECEIVER = "gnss"
"""Its name, where the line's config has none."""
ALL = -1
"""In place of a time: every camera has ended."""
LOOK_EVERY_S = 0.1
MOST_AT_ONCE = 50
"""500 a second: a recorder syncs each of them to its disk."""


def reached_ns(infos: Mapping[str, CameraInfo], *, cameras: Sequence[str], run: str) -> int | None:
    """Time of the recording that all its cameras have come to; None before. Cameras that ended hold nothing back.

    Args:
        infos: what the cameras said last, by key.

    Returns:
        Unix time of the newest frame of the camera that is furthest behind, ns; after the last one has ended `ALL`.
    """
    said = {info.camera: info for info in infos.values() if info.run == run}
    if not set(cameras) <= set(said):
        return None
    going = [said[name].last_captured_ns for name in cameras if said[name].state != "ended"]
    if not going:
        return ALL
    known = [at for at in going if at is not None]
    return min(known) if len(known) == len(going) else None


def due(positions: Sequence[Position], told: int, until_ns: int | None) -> Sequence[Position]:
    """The next positions after the first `told`, in their order, up to that time (or `ALL`), `MOST_AT_ONCE` of them.

    One whose time lies ahead holds back those behind it: a receiver's order is kept.
    """
    if until_ns is None:
        return ()
    end = told
    while end < min(len(positions), told + MOST_AT_ONCE) and (until_ns == ALL or positions[end].time_ns <= until_ns):
        end += 1
    return positions[told:end]


def recorded_positions(path: Path, *, receiver: str = RECEIVER, run: str) -> list[Position]:
    """All positions of a file, numbered from 0, as a receiver of that name told them.

    Raises:
        InputError: not readable, damaged, or values that no position has.
    """
    found = [
        Position(
            receiver, run, n, at.time_ns, at.time_ns if at.fix_ns is None else at.fix_ns,
            at.lat_deg, at.lon_deg, at.quality, at.hdop, at.satellites,
        )
        for n, at in enumerate(read_positions(path))
    ]  # fmt: skip
    for at in found:
        try:
            at.check()
        except UnsendableError as error:
            raise InputError(f"track {path}, position {at.n}: {error}") from error
    return found


class _Teller:
    """How far the positions were told."""

    def __init__(self, node: Node, positions: Sequence[Position]) -> None:
        self._out = ReliablePublisher(node, topics.POSITION, receiver=node.name)
        self._counters, self._positions = node.counters, positions
        for counter in ("positions", "no_fix"):
            node.counters.add(counter, 0)
        self.told = 0

    def tell(self, until_ns: int | None) -> bool:
        """Tell what is `due`; False where nothing is."""
        now = due(self._positions, self.told, until_ns)
        for at in now:
            self._out.put(at)
            self._counters.add("positions")
            self._counters.add("no_fix", int(at.quality == 0))
        self.told += len(now)
        return bool(now)


def run_recorded(config: LineConfig, *, run: str) -> None:
    """Tell the positions beside the line's ledger, where the replay has put them, until stopped.

    A process that is started again tells them from the first on: who keeps them knows those it has by their numbers.

    Raises:
        InputError: there are none, or they cannot be used.
    """
    name = config.gnss.name if config.gnss else RECEIVER
    positions = recorded_positions(config.aggregator.out / POSITIONS_FILE, receiver=name, run=run)
    cameras = sorted(config.cameras)
    with Node("gnss", name, config=config, run=run) as node:
        infos = KeptSubscriber(node, topics.CAMERA_INFO, CameraInfo, camera="*")
        teller = _Teller(node, positions)
        while not node.stop.wait(LOOK_EVERY_S):
            node.progress()
            teller.tell(reached_ns(infos.latest(), cameras=cameras, run=run))
        if reached_ns(infos.latest(), cameras=cameras, run=run) == ALL:
            while teller.tell(ALL):
                pass
        node.log.info("%d of %d recorded positions told", teller.told, len(positions))
