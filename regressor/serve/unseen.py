"""A regressor without a segmenter weighs nothing. Its config may name another line than theirs: then it says so."""

from __future__ import annotations

import time
from collections.abc import Callable

from conveyor import topics
from conveyor.lines import ASK_S, looked_for_elsewhere, nodes_of_lines
from conveyor.node import Node

LOOKS, LOOK_EVERY_S = 3, 10.0
"""A segmenter may start some seconds after its regressors, and an answer may be lost."""


class Lookout:
    """Looks for the segmenters of its line, some times, while no view comes; says once that there are none."""

    def __init__(self, node: Node, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._node = node
        self._clock = clock
        self._looks = 0
        self._due_s = clock() + LOOK_EVERY_S

    def look(self, *, at_work: bool) -> None:
        """Call it in each turn of the loop. `at_work`: views have come, so there is a segmenter."""
        if at_work:
            self._looks = LOOKS
        if self._looks >= LOOKS or self._clock() < self._due_s:
            return
        self._looks += 1
        self._due_s += LOOK_EVERY_S
        if self._sees_one():
            self._looks = LOOKS
        elif self._looks == LOOKS:
            self._say()

    def _sees_one(self) -> bool:
        key = topics.ALIVE.key(self._node.line, role="segmenter", name="*")
        return any(reply.ok is not None for reply in self._node.session.liveliness().get(key, timeout=ASK_S))

    def _say(self) -> None:
        line = self._node.line
        if elsewhere := looked_for_elsewhere(line, nodes_of_lines(self._node.session)):
            told = f"{elsewhere}: nothing is weighed; if that is meant, correct `name` in the config"
        else:
            told = f"no segmenter of line '{line}' was seen for {LOOKS * LOOK_EVERY_S:.0f} s: nothing is weighed so far"
        self._node.log.warning("%s", told)
