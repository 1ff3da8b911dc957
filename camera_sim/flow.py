"""When a recorded frame may be sent: its time has come, and the segmenter has room for it. No sockets, no clock."""

from __future__ import annotations

from collections import OrderedDict

from conveyor.messages import Frame

RESEND_AFTER_S = (0.3, 2.0)
"""Time without progress after which frames are sent again: at least, and before anything is known. Four times what a
frame takes to get done, and twice as long after each time that it was in vain (as TCP does, RFC 6298 section 5)."""
LONGEST_PATIENCE_S = 16.0
LONGEST_STEP_S = 2.0


class Pace:
    """Due times of frames by their capture times; `speed` times real time, 0 = at once."""

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._last_ns: int | None = None
        self._due_s = 0.0

    def due_s(self, captured_ns: int, now_s: float) -> float:
        """When the frame captured at `captured_ns` is due; call it once per frame, in order.

        A clock that jumps back takes no time, one that jumps ahead at most 2 s: a replay does not wait for a fault.
        """
        if self._speed <= 0:
            return now_s
        if self._last_ns is None:
            self._due_s = now_s
        else:
            step_s = (captured_ns - self._last_ns) / 1e9
            self._due_s += min(max(step_s, 0.0), LONGEST_STEP_S) / self._speed
        self._last_ns = captured_ns
        self._due_s = max(self._due_s, now_s - LONGEST_STEP_S)
        return self._due_s


class SendWindow:
    """Frames on their way: at most `size` of them, sent again while no one says that they arrived."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._sent: OrderedDict[int, Frame] = OrderedDict()
        self._sent_s = 0.0
        self._takes_s = RESEND_AFTER_S[1] / 4
        self._in_vain = 0
        self._resent = False
        self.moved_s = 0.0

    @property
    def has_room(self) -> bool:
        """One more frame may be sent."""
        return len(self._sent) < self._size

    @property
    def in_flight(self) -> int:
        """Frames sent and not yet done."""
        return len(self._sent)

    def sent(self, frame: Frame, now_s: float) -> None:
        """Note that `frame` was sent."""
        if not self._sent:
            self.moved_s = now_s
        self._sent[frame.seq] = frame
        self._sent_s = now_s

    def done(self, done_seq: int, now_s: float) -> int:
        """The segmenter is done with everything up to `done_seq`; returns how many frames that frees."""
        freed = [seq for seq in self._sent if seq <= done_seq]
        for seq in freed:
            del self._sent[seq]
        if freed:
            if not self._resent:  # else no one knows which sending was the one that arrived (Karn's rule)
                took_s = (now_s - max(self.moved_s, self._sent_s)) / len(freed)
                took_s = min(took_s, self.resend_after_s)  # longer: this process stood still
                self._takes_s += 0.2 * (max(took_s, 0.0) - self._takes_s)
                self._in_vain = 0
            self._resent = False
            self.moved_s = now_s
        return len(freed)

    def to_resend(self, now_s: float) -> list[Frame]:
        """All frames in flight, in order, when nothing moved for longer than usual; again after as long."""
        if not self._sent or now_s - max(self._sent_s, self.moved_s) < self.resend_after_s:
            return []
        self._sent_s = now_s
        self._resent = True
        self._in_vain += 1
        return list(self._sent.values())

    @property
    def resend_after_s(self) -> float:
        """How long without progress is longer than usual."""
        usual_s = max(4 * self._takes_s, RESEND_AFTER_S[0])
        return float(min(usual_s * 2 ** min(self._in_vain, 8), LONGEST_PATIENCE_S))

    def still_s(self, now_s: float) -> float:
        """How long frames have been waiting without any getting done."""
        return now_s - self.moved_s if self._sent else 0.0
