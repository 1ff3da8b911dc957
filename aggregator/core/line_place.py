"""Which place of the belt lies at the cameras' centre row at a moment: where a load begins or ends.

The newest mark of a camera says how far the belt was; from there it goes on by its last speed, or back along the
camera's own history where the moment lies before. Before the first mark of a run it is the run's beginning.
"""

from __future__ import annotations

import math

from aggregator.core.cameras import Cameras, CameraState
from conveyor.errors import InputError

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
    came_s, captured_ns = state.marked_s
    since_s = min(now_s - age_s - came_s, cameras.stall_s)
    t_ns = captured_ns + round(since_s * state.pace * 1e9)
    travel_m = mark.travel_m + sight.s_at(t_ns) - sight.curve[-1][1]
    row_x_m = sight.row_x_m or 0.0
    return cameras.place_x_m(
        name, row_x_m - travel_m, t_ns=t_ns, own_travel_m=travel_m, estimated=mark.travel_estimated
    )
