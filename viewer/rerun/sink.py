"""What Rerun's sinks have in common: a recording stream and the pen that draws into it."""

from __future__ import annotations

from typing import Any

from viewer.rerun.layout import blueprint
from viewer.rerun.sdk import Pen, new_stream
from viewer.scene.primitives import Entry, Layout
from viewer.sink import Sink


class RerunSink(Sink):
    """See `viewer.sink`."""

    _stream: Any = None
    _pen: Pen | None = None

    def _put(self, entry: Entry) -> None:
        if isinstance(entry.primitive, Layout):
            self._stream.send_blueprint(blueprint(entry.primitive))
        elif self._pen is not None:
            self._pen.draw(entry)

    def _new_stream(self) -> None:
        self._stream = new_stream(self._run_id)
        self._pen = Pen(self._stream)
