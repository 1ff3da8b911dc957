"""Frames of a live camera with the travel that the line's encoder tells."""

from __future__ import annotations

import time
from dataclasses import replace

from camera_sim.stamps import Known, TravelStamps
from conveyor import topics
from conveyor.config_encoder import EncoderConfig
from conveyor.delivery import LatestSubscriber
from conveyor.messages import Frame, Travel
from conveyor.node import Node

CAPACITY = 128
NEXT_WITHIN_S = 0.1
"""A frame waits so long for what the encoder tells next; it tells 50 times a second."""
FIRST_WITHIN_S = 10.0
ALONE_WITHIN_S = 20.0
"""A run that begins waits so long for its encoder, once its segmenter is there, and so much longer for that one."""


class FrameStamper:
    """What the encoder of a line tells, laid under the frames of one camera of it.

    Counters: `frames_with_travel`, `frames_without_travel`; the level `encoder_silent_s` is 0 while it tells.
    """

    def __init__(self, node: Node, encoder: EncoderConfig) -> None:
        self._node = node
        self._name = encoder.name
        self._travels = LatestSubscriber(node, topics.TRAVEL, Travel, capacity=CAPACITY, source=encoder.name)
        self._stamps = TravelStamps()
        self._began_s = time.monotonic()
        self._heard_s: float | None = None
        self._silent = self._foreign = False
        for counter in ("frames_with_travel", "frames_without_travel"):
            node.counters.add(counter, 0)

    def listen(self) -> None:
        """Take what was told meanwhile."""
        self._take(0.0)

    def first(self, frame: Frame, *, segmenter: bool) -> Frame | None:
        """A frame of a run that begins, as `stamped`; None where it is held back: the run goes to its end as its first
        frame says, with an encoder or without. `segmenter`: it was heard, and the encoder asks it where the belt is.
        """
        now_s = time.monotonic()
        if segmenter and self._heard_s is None:
            self._heard_s = now_s
        travel_m = self._travel_of(frame)
        waited_s = now_s - self._began_s - ALONE_WITHIN_S if self._heard_s is None else now_s - self._heard_s
        if travel_m is None and waited_s < FIRST_WITHIN_S:
            return None
        if travel_m is None:
            self._node.log.error("the encoder '%s' tells nothing: this run goes by the load", self._name)
        return self._with(frame, travel_m)

    def stamped(self, frame: Frame) -> Frame:
        """The frame with its travel; without one where the encoder was silent when it was taken. One that brings its
        own keeps it.
        """
        return self._with(frame, self._travel_of(frame))

    def _with(self, frame: Frame, travel_m: float | None) -> Frame:
        self._node.counters.add("frames_without_travel" if travel_m is None else "frames_with_travel")
        self._tell_silent(silent=travel_m is None)
        return frame if travel_m is None else replace(frame, travel_m=travel_m)

    def _travel_of(self, frame: Frame) -> float | None:
        """Its own, or the encoder's at the moment it was taken; None where neither is known."""
        taken_ns = self._stamps.taken_ns(frame.captured_ns, day_ns=time.time_ns(), now_ns=time.monotonic_ns())
        self._tell_foreign()
        if frame.travel_m is not None or taken_ns is None:
            return frame.travel_m
        return self._travel_at(taken_ns)

    def _travel_at(self, taken_ns: int) -> float | None:
        """Waits for what the encoder tells next, where that says it."""
        self._take(0.0)
        until_s = time.monotonic() + NEXT_WITHIN_S
        while (travel := self._stamps.at(taken_ns, time.monotonic_ns())) is Known.NOT_YET:
            left_s = until_s - time.monotonic()
            if left_s <= 0 or self._node.stop.is_set():
                break
            self._take(left_s)
        return travel if isinstance(travel, float) else None

    def _take(self, timeout_s: float) -> None:
        """What was told; waits for it at most so long."""
        came = self._travels.get_with_arrival(timeout_s)
        while came is not None:
            travel, arrived_ns = came
            if travel.run == self._node.run and not travel.estimated:
                self._stamps.told(travel.captured_ns, travel.travel_m, arrived_ns)
            came = self._travels.get_with_arrival(0.0)

    def _tell_silent(self, *, silent: bool) -> None:
        now_s = time.monotonic()
        silent_ns = self._stamps.silent_ns(time.monotonic_ns())
        silent_s = now_s - self._began_s if silent_ns is None else silent_ns * 1e-9
        self._node.counters.gauge("encoder_silent_s", round(silent_s, 1) if silent else 0.0)
        if silent != self._silent:
            self._silent = silent
            if silent:
                self._node.log.warning("nothing from the encoder '%s': the load tells the travel", self._name)
            else:
                self._node.log.warning("the encoder '%s' tells travel again", self._name)

    def _tell_foreign(self) -> None:
        if self._stamps.foreign and not self._foreign:
            self._node.log.warning(
                "frames are not stamped with this machine's clock: the encoder's travel is laid under them by when "
                "they come, so that places lie behind by what the belt moves until then"
            )
        self._foreign = self._stamps.foreign
