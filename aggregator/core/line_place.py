"""Which place of the belt lies at the cameras' centre row at a moment: where a load begins or ends.

The newest mark of a camera says how far the belt was; from there it goes on by its last speed, or back along the
camera's own history where the moment lies before. Before the first mark of a run it is the run's beginning.
"""

from __future__ import annotations

import math

from aggregator.core.cameras import Cameras, CameraState
from conveyor.errors import InputError
from conveyor.messages import Mark

SETTLED_S = 1.0
"""After a start the first marks may have waited for this process: how late they were shows when more have come."""


class NotYetKnownError(InputError):
    """The place is not known yet; it will be once a camera tells more."""


def place_now_x_m(cameras: Cameras, *, now_s: float, age_s: float) -> float:
    """The place, metres, that lay at the centre row `age_s` ago; infinite before the run began.

    Args:
        now_s: of the clock that the cameras' marks were received by.

    Raises:
        NotYetKnownError: no camera tells at the moment. InputError: every camera has ended.
    """
    if cameras.final:
        raise InputError("every camera has ended: no more tubers come in this run, start the load in the next one")
    marked = {name: state for name, state in cameras.states.items() if state.mark is not None}
    if not marked:
        return math.inf
    fresh = [name for name in cameras.names if name in marked and _settled(marked[name], now_s)]
    silent = cameras.away(now_s)
    for name in sorted(fresh, key=lambda name: (name in silent, cameras.names.index(name))):
        place = _place_x_m(cameras, name, now_s=now_s, age_s=age_s)
        if place is not None:
            return place
    waiting = ", ".join(name for name in cameras.names if name not in fresh) or "the first camera"
    raise NotYetKnownError(f"where the belt is now is not known yet: waiting for {waiting}")


def _settled(state: CameraState, now_s: float) -> bool:
    return state.first_marked_s is not None and now_s - state.first_marked_s >= SETTLED_S


def _place_x_m(cameras: Cameras, name: str, *, now_s: float, age_s: float) -> float | None:
    state = cameras.states[name]
    mark, sight = state.mark, state.sight
    if mark is None or state.marked_s is None or not sight.curve:
        return None
    t_ns = _camera_ns(state, now_s - age_s, limit_s=cameras.stall_s)
    travel_m = _travel_m(state, mark, t_ns)
    own_x_m = (sight.row_x_m or 0.0) - travel_m
    return cameras.place_x_m(
        name, own_x_m, t_ns=t_ns, own_travel_m=travel_m, estimated=mark.travel_estimated, wait=False
    )


def _camera_ns(state: CameraState, at_s: float, *, limit_s: float) -> int:
    """The camera's clock at a moment of ours: by the newest frame that it published, or else by its newest mark; a
    camera that tells nothing for longer than `limit_s` is not believed to go on."""
    came_s, captured_ns = state.marked_s or (at_s, 0)
    published_ns = state.sight.published.last_ns
    if published_ns is not None and published_ns > captured_ns and state.info_s is not None and state.info_s <= at_s:
        came_s, captured_ns = state.info_s, published_ns
    return captured_ns + round(min(at_s - came_s, limit_s) * state.pace * 1e9)


def _travel_m(state: CameraState, mark: Mark, t_ns: int) -> float:
    """Travel at a moment of the camera's clock: along its marks, beyond them by the encoder where the camera publishes
    what that says, else by the belt's last speed."""
    known, sight = state.sight.published, state.sight
    newer_ns = (known.last_ns or 0) - mark.captured_ns
    if t_ns > mark.captured_ns and newer_ns > 0 and known.last_travel_m is not None and not mark.travel_estimated:
        return mark.travel_m + (known.last_travel_m - mark.travel_m) * (t_ns - mark.captured_ns) / newer_ns
    return mark.travel_m + sight.s_at(t_ns) - sight.curve[-1][1]
