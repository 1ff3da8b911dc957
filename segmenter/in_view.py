"""What a camera has in view, with the weights known so far: told to viewers, and read by no one who counts."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

from conveyor.messages import TrackInView, TracksInView
from segmenter.provisional import Provisional
from segmenter.track.track import State, TrackState

if TYPE_CHECKING:
    from segmenter.camera_run import CameraRun

MOST = 1024
LARGEST_MM = 2000.0
"""What the message may hold; a belt full of soil is one instance."""
_STATES: dict[State, Literal["open", "counted", "refused"]] = {
    State.OPEN: "open",
    State.COUNTED: "counted",
    State.DISCARDED: "refused",
}


def tracks_in_view(run: CameraRun, captured_ns: int) -> TracksInView:
    """The tracks that `run` has in view."""
    tracks = []
    for track in run.core.tracks_in_view()[:MOST]:
        track_id = track.track_id(run.run, run.camera)
        tracks.append(_track(track, track_id, run.provisional.of(track_id)))
    return TracksInView(run.camera, run.run, captured_ns, tuple(tracks))


def _track(track: TrackState, track_id: str, known: Provisional | None) -> TrackInView:
    return TrackInView(
        track_id=track_id,
        place_x_m=track.place_x_m,
        place_y_m=track.place_y_m,
        side_mm=min(1e3 * math.sqrt(max(track.area_m2, 0.0)), LARGEST_MM),
        height_mm=min(1e3 * max(track.height_m, 0.0), LARGEST_MM),
        state=_STATES[track.state],
        weight_g=None if known is None else known.weight_g,
        low_g=None if known is None else known.low_g,
        high_g=None if known is None else known.high_g,
    )
