"""The balance sheets of a camera's tracks and views: as marks state them, and what of them is left after a restart."""

from __future__ import annotations

from collections import Counter

from conveyor.messages import Track
from conveyor.reasons import TrackRefusal, ViewLoss


def but_zeros(sheet: dict[str, int]) -> dict[str, int]:
    """The sheet without what is nothing."""
    return {name: n for name, n in sheet.items() if n}


def tracks_left(sheet: dict[str, int], tracks: list[Track]) -> dict[str, int]:
    """A dead process's sheet: `tracks` were logged after it was written, the rest of the open ones are lost."""
    logged, still_open = sum(track.kind == "tuber" for track in tracks), sheet.get("open", 0)
    foreign = len(tracks) - logged
    left = {name: n for name, n in sheet.items() if name != "open"}
    left["opened"] = left.get("opened", 0) + max(0, logged - still_open)
    left["counted"] = left.get("counted", 0) + logged
    discarded = f"discarded_{TrackRefusal.RESTART}"
    left[discarded] = left.get(discarded, 0) + max(0, still_open - logged)
    if foreign:
        left["foreign"] = left.get("foreign", 0) + foreign
    return left


def lost_share(before: dict[str, int], left: dict[str, int]) -> float:
    """Of a dead process's tubers, those that it took with it: where no frame comes any more, so much of its belt was
    not seen."""
    name = f"discarded_{TrackRefusal.RESTART}"
    lost = left.get(name, 0) - before.get(name, 0)
    return lost / (lost + left.get("counted", 0)) if lost > 0 else 0.0


def as_logged(views: dict[str, int], waiting: Counter[str]) -> dict[str, int]:
    """The sheet of views as the log has it: what is answered or lost, but of a track that is not logged, is outstanding
    to a process that finds nothing but the log; `waiting` is how many of each name are.
    """
    left = {name: n - waiting[name] for name, n in views.items() if name in ("sent", "weighed") or n > waiting[name]}
    return {**left, "outstanding": views["outstanding"] + waiting.total()}


def views_left(sheet: dict[str, int], logged: list[Track]) -> dict[str, int]:
    """A dead process's sheet with the answers of the tracks it logged since; other views without answer are lost."""
    weighed = sum(len(track.views) for track in logged)
    lost = Counter(name for track in logged for name in Counter(track.views_lost).elements())
    answered = weighed + lost.total()
    outstanding = sheet.get("outstanding", 0)
    left = {name: n for name, n in sheet.items() if name != "outstanding"}
    left["sent"] = left.get("sent", 0) + max(0, answered - outstanding)
    left["weighed"] = left.get("weighed", 0) + weighed
    restarted = f"lost_{ViewLoss.RESTART}"
    left[restarted] = left.get(restarted, 0) + max(0, outstanding - answered)
    return added(left, {f"lost_{reason}": n for reason, n in lost.items()})


def added(sheet: dict[str, int], base: dict[str, int]) -> dict[str, int]:
    """Both sheets together."""
    return {name: sheet.get(name, 0) + base.get(name, 0) for name in {**sheet, **base}}
