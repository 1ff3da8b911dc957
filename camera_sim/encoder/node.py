"""The encoder's process: counts from a device, travel onto the line; it comes back by itself."""

from __future__ import annotations

import time

from camera_sim.device import DeviceCare
from camera_sim.encoder.counts import Counter, open_counter
from camera_sim.encoder.shaft import Reading, Shaft
from camera_sim.encoder.zero import Standing, Zero
from conveyor import topics
from conveyor.config import LineConfig
from conveyor.config_encoder import EncoderConfig
from conveyor.counters import is_told
from conveyor.delivery import KeptSubscriber, LatestPublisher, LatestSubscriber
from conveyor.errors import ConfigError, DeviceError
from conveyor.messages import FrameProgress, Travel
from conveyor.node import Node

SILENT_AFTER_S = 3.0
"""A device that says nothing for so long is opened again."""
TELL_EVERY_NS, LEVELS_EVERY_NS = 15_000_000, 250_000_000
TRAVELS = 32
COUNTED = ("counts", "lines_refused", "encoder_lost", "encoder_silent", "counts_odd", "counts_lost", "clock_steps")


class EncoderNode:
    """The encoder of a line, until it is stopped."""

    def __init__(self, config: LineConfig, settings: EncoderConfig, *, run: str) -> None:
        self._settings = settings
        self._node = Node("encoder", settings.name, config=config, run=run)
        self._shaft = Shaft(settings.metres_per_pulse, bits=settings.bits)
        self._zero = Zero(run, config.hears_encoder)
        self._care = DeviceCare(self._node, lost="encoder_lost", told="travels")
        self._told_ns = self._levels_ns = 0

    def run(self) -> None:
        """Read and publish; a device that is gone is opened again, with back-off, forever."""
        with self._node as node:
            self._out = LatestPublisher(node, topics.TRAVEL, source=node.name)
            self._travels = [
                LatestSubscriber(node, topics.TRAVEL, Travel, capacity=TRAVELS, source=camera)
                for camera in self._zero.cameras
            ]
            self._progress = KeptSubscriber(node, topics.FRAME_PROGRESS, FrameProgress, camera="*")
            for name in COUNTED:
                node.counters.add(name, 0)
            while not node.stop.is_set():
                try:
                    counter = open_counter(self._settings, wait=node.stop.wait)
                    self._care.opened()
                    self._read(counter)
                except DeviceError as error:
                    self._care.lost(error)
                    self._shaft.reopened()

    def _read(self, counter: Counter) -> None:
        heard_s = time.monotonic()
        try:
            while not self._node.stop.is_set():
                self._node.progress()
                try:
                    count = counter.read()
                except ValueError as error:
                    self._refuse(error)
                    count = None
                self._listen()
                if count is not None:
                    heard_s = time.monotonic()
                    self._take(count)
                elif time.monotonic() - heard_s > SILENT_AFTER_S:
                    self._node.counters.add("encoder_silent")
                    raise DeviceError(f"encoder {self._settings.source} said nothing for {SILENT_AFTER_S:g} s")
        finally:
            counter.close()

    def _take(self, count: int) -> None:
        """A count, read now."""
        now_ns, day_ns = time.monotonic_ns(), self._care.day_ns()
        self._node.counters.add("counts")
        reading = self._shaft.read(count, now_ns)
        if reading is Reading.ODD:
            self._node.counters.add("counts_odd")
            return
        if reading is Reading.LOST:
            self._lost()
        if self._zero.decide(now_ns, self._shaft.turned_m):
            self._node.log.info("tells travel from %.3f m on", self._travel_m)
        if now_ns - self._levels_ns >= LEVELS_EVERY_NS:
            self._levels_ns = now_ns
            self._tell_levels()
        if self._zero.standing is Standing.TELLS and now_ns - self._told_ns >= TELL_EVERY_NS:
            self._told_ns = now_ns
            self._out.put(Travel(self._node.name, self._node.run, day_ns, self._travel_m, estimated=False))

    def _tell_levels(self) -> None:
        levels = {"travel_m": self._travel_m, "belt_mps": self._shaft.speed_mps()}
        for name, level in {**levels, "tells": float(self._zero.standing is Standing.TELLS)}.items():
            self._node.counters.gauge(name, level)

    def _lost(self) -> None:
        """The counter lost its count; it is told at first, and ever more seldom."""
        self._node.counters.add("counts_lost")
        lost = self._node.counters.get("counts_lost")
        if is_told(lost):
            self._node.log.warning(
                "the encoder's count jumped %s, the %d. time: it began again, or metres_per_pulse is too large; its "
                "travel goes on where the load says that the belt is",
                self._shaft.jump, lost,
            )  # fmt: skip
        self._zero.ask()

    @property
    def _travel_m(self) -> float:
        return self._zero.zero_m + self._shaft.turned_m

    def _listen(self) -> None:
        """What the segmenters say: by it the zero is laid, while it is not known where the belt is."""
        asking = self._zero.standing is Standing.ASKING
        offset_ns = time.monotonic_ns() - self._care.day_ns()
        for travels in self._travels:
            while len(travels) and (said := travels.get(0.0)) is not None:
                day_ns = time.monotonic_ns() - offset_ns
                self._zero.travel(said, clock_ns=day_ns, turned_at=lambda t: self._shaft.turned_at(t + offset_ns))
        if asking:
            for progress in self._progress.latest().values():
                self._zero.progress(progress)
            if self._zero.standing is Standing.LATE:
                self._node.counters.gauge("late", 1.0)
                self._node.log.warning(
                    "run %s was begun without the encoder and goes on by the load: it tells travel from the next run",
                    self._node.run,
                )

    def _refuse(self, error: ValueError) -> None:
        self._node.counters.add("lines_refused")
        refused = self._node.counters.get("lines_refused")
        if is_told(refused):
            self._node.log.warning("%s, the %d. that is refused", error, refused)


def run_encoder(config: LineConfig, *, run: str) -> None:
    """Read the line's encoder until stopped.

    Raises:
        ConfigError: the line has no [encoder].
    """
    if config.encoder is None:
        raise ConfigError(
            'this line has no [encoder]; add it with source = "serial:/dev/ttyACM0" or the like and metres_per_pulse'
        )
    EncoderNode(config, config.encoder, run=run).run()
