"""Empties the outbox: one thread per channel, in order, with back-off while a channel cannot be reached."""

from __future__ import annotations

import logging
import threading

from tuberline.alarms.channels import Channel, ChannelError, RefusedError
from tuberline.alarms.outbox import Outbox

log = logging.getLogger("alarms")

FIRST_WAIT_S = 1.0
LONGEST_WAIT_S = 120.0
LOOK_EVERY_S = 1.0


class Sender:
    """Sends what `outbox` keeps for `channel`. What the server will never take is dropped, with a word."""

    def __init__(self, channel: Channel, outbox: Outbox, *, first_wait_s: float = FIRST_WAIT_S) -> None:
        self._channel = channel
        self._outbox = outbox
        self._first_wait_s = first_wait_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"send-{channel.id}", daemon=True)

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def stop(self) -> None:
        """Send no more; what is under way and not answered is kept, and sent by the next process under the same id."""
        self._stop.set()

    def join(self, within_s: float) -> None:
        """Wait for its thread to end."""
        self._thread.join(within_s)

    def _run(self) -> None:
        wait_s = self._first_wait_s
        while not self._stop.is_set():
            if self.send_next():
                wait_s = self._first_wait_s
            elif self._outbox.waiting(self._channel.id):
                self._stop.wait(wait_s)
                wait_s = min(2 * wait_s, LONGEST_WAIT_S)
            else:
                self._outbox.wait(LOOK_EVERY_S)

    def send_next(self) -> bool:
        """Hand over the oldest message; False where there is none, or it was not taken."""
        head = self._outbox.head(self._channel.id)
        if head is None:
            return False
        n, message, lost = head
        try:
            self._channel.send(message, lost_before=lost)
        except RefusedError as error:
            log.error("%s does not take %s: %s; not sent there", self._channel.shown, message.id, error)
            self._outbox.done(self._channel.id, n)
            return True
        except ChannelError as error:
            waiting = self._outbox.waiting(self._channel.id)
            log.warning("%s cannot be reached: %s; %d messages wait", self._channel.shown, error, waiting)
            return False
        except Exception as error:  # it must not end this thread, and with it all alarms of this channel
            name = type(error).__name__  # its text may hold the address with its secrets
            log.error("%s: sending failed by %s, a fault of the program; it is tried again", self._channel.shown, name)
            return False
        self._outbox.done(self._channel.id, n, lost=lost)
        log.info("%s took %s: %s", self._channel.shown, message.event, message.title)
        return True
