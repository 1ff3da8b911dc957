"""The receiver's process: each position into positions.csv of the run, then onto the line; it comes back by itself."""

from __future__ import annotations

import time

from camera_sim.device import DeviceCare
from camera_sim.gnss.receivers import open_receiver
from camera_sim.lines import LineDevice
from conveyor import topics
from conveyor.config import LineConfig
from conveyor.config_yield import GnssConfig
from conveyor.delivery import ReliablePublisher
from conveyor.errors import ConfigError, DeviceError, UnsendableError
from conveyor.formats.nmea import Fix, NmeaFixes
from conveyor.formats.positions import POSITIONS_FILE, PositionsWriter
from conveyor.messages import Position
from conveyor.node import Node

SILENT_AFTER_S = 10.0
"""A receiver that says nothing for so long is opened again."""
COUNTED = ("positions", "no_fix", "lines_refused", "receiver_lost", "receiver_silent", "clock_steps")


class GnssNode:
    """One receiver of a line, until it is stopped."""

    def __init__(self, config: LineConfig, settings: GnssConfig, *, run: str) -> None:
        self._settings = settings
        self._node = Node("gnss", settings.name, config=config, run=run)
        self._path = config.aggregator.out / POSITIONS_FILE
        self._fixes = NmeaFixes()
        self._care = DeviceCare(self._node, lost="receiver_lost", told="positions")
        self._refused = 0

    def run(self) -> None:
        """Read, keep and publish; a receiver that is gone is opened again, with back-off, forever."""
        with self._node as node, PositionsWriter(self._path) as file:
            out = ReliablePublisher(node, topics.POSITION, receiver=node.name)
            for counter in COUNTED:
                node.counters.add(counter, 0)
            while not node.stop.is_set():
                try:
                    receiver = open_receiver(self._settings.source, wait=self._care.rest)
                    self._care.opened()
                    self._read(receiver, file, out)
                except DeviceError as error:
                    self._care.lost(error)
                except EOFError:
                    node.log.info("the recorded positions end: %d positions", file.rows)
                    while not self._care.rest(1.0):
                        pass

    def _read(self, receiver: LineDevice, file: PositionsWriter, out: ReliablePublisher) -> None:
        heard_s = time.monotonic()
        try:
            while not self._node.stop.is_set():
                self._node.progress()
                line = receiver.read()
                if line is None:
                    if time.monotonic() - heard_s > SILENT_AFTER_S:
                        self._node.counters.add("receiver_silent")
                        raise DeviceError(
                            f"GNSS receiver {self._settings.source} said nothing for {SILENT_AFTER_S:g} s"
                        )
                    continue
                heard_s = time.monotonic()
                fix = self._fixes.push(line)
                if fix is not None:
                    self._tell(fix, file, out)
                self._count_refused()
        finally:
            receiver.close()

    def _tell(self, fix: Fix, file: PositionsWriter, out: ReliablePublisher) -> None:
        """Durable first, then told."""
        position = Position(
            receiver=self._node.name,
            run=self._node.run,
            n=file.rows,
            time_ns=self._care.day_ns(),
            fix_ns=fix.fix_ns,
            lat_deg=fix.lat_deg,
            lon_deg=fix.lon_deg,
            quality=fix.quality,
            hdop=fix.hdop,
            satellites=fix.satellites,
        )
        try:
            position.check()
        except UnsendableError:  # a receiver's sentence may be whole and say what cannot be, a dilution of 9999.9
            self._fixes.refused["beyond range"] += 1
            return
        file.add(position)
        out.put(position)
        self._node.counters.add("positions")
        self._node.counters.add("no_fix", int(fix.quality == 0))

    def _count_refused(self) -> None:
        refused = self._fixes.refused.total()
        if refused > self._refused:
            self._node.counters.add("lines_refused", refused - self._refused)
            self._refused = refused


def run_gnss(config: LineConfig, *, run: str) -> None:
    """Read the line's receiver until stopped.

    Raises:
        ConfigError: the line has no [gnss].
    """
    if config.gnss is None:
        raise ConfigError('this line has no [gnss]; add it with source = "serial:/dev/ttyACM0" or the like')
    GnssNode(config, config.gnss, run=run).run()
