"""From a group of tracks to a tuber, ready for the ledger."""

from __future__ import annotations

from aggregator.core.foreign import mean_odds
from aggregator.core.fusion import fuse
from aggregator.core.merge import Group
from aggregator.core.size_fusion import fuse_sizes
from conveyor.camera_flags import CUT
from conveyor.layers import on_others_flag
from conveyor.messages import Tuber

MOST_FLAGS = 256


def make_tuber(group: Group, *, run: str, tuber_id: int) -> Tuber:
    """The tuber that all tracks of `group` saw.

    Size, weight and place come from the tracks that were taken for a tuber's and saw it whole, where there are any.
    Flags: what its views were flagged with, 'on_others_35_mm' (it lies on others, that high), what its cameras were
    (`conveyor.camera_flags`), 'cut' (never seen whole), 'late' (came after its place was committed),
    'travel_estimated', 'rejoined' (two tracks of one camera).
    """
    group = Group([member for member in group.members if member.track.kind == "tuber"] or group.members)
    members = sorted(group.members, key=lambda member: (member.camera, member.track.first_seq, member.track.track_id))
    tracks = [member.track for member in members]
    sized = [member.track for member in group.best]
    weighed = [track for track in sized if track.views] or tracks
    whole = any(track.whole for track in tracks)
    cameras = tuple(sorted({member.camera for member in members}))
    length_mm = sum(track.length_mm for track in sized) / len(sized)
    width_mm = sum(track.width_mm for track in sized) / len(sized)
    height_mm = sum(track.height_mm for track in sized) / len(sized)
    weight = fuse(
        [view for track in weighed for view in track.views],
        visible_volumes_ml=[track.visible_volume_ml for track in sized],
        axes_mm=(length_mm, width_mm, height_mm),
    )
    flags = set(weight.flags)
    flags |= {flag for track in tracks for flag in track.flags}
    flags |= set() if whole else {CUT}
    flags |= {"late"} if any(member.late for member in members) else set()
    flags |= {"travel_estimated"} if any(track.travel_estimated for track in tracks) else set()
    flags |= {"rejoined"} if len(members) > len(cameras) else set()
    support_mm = sum(track.support_mm for track in sized) / len(sized)
    flags |= {on_others_flag(support_mm)} if support_mm >= 1 else set()
    return Tuber(
        tuber_id=tuber_id,
        run=run,
        crossed_ns=min(track.crossed_ns for track in tracks),
        place_x_m=group.place_x_m,
        place_y_m=group.place_y_m,
        weight_g=weight.weight_g,
        low_g=weight.low_g,
        high_g=weight.high_g,
        length_mm=length_mm,
        width_mm=width_mm,
        height_mm=height_mm,
        views=weight.views,
        method=weight.method,
        model=weight.model,
        flags=tuple(sorted(flags)[:MOST_FLAGS]),
        cameras=cameras,
        tracks=tuple(track.track_id for track in tracks),
        sizes=fuse_sizes([view.sizes for track in weighed for view in track.views if view.sizes is not None]),
        log_odds=mean_odds(group),
    )
