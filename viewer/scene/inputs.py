"""What the viewer subscribes to. Without pictures in the profile it does not even subscribe to the heavy topics."""

from __future__ import annotations

from conveyor import topics
from conveyor.delivery import Inbox, KeptSubscriber, LatestSubscriber, Presence, ReliableSubscriber
from conveyor.messages import (
    CameraInfo,
    Counters,
    Frame,
    Position,
    Totals,
    TrackEntry,
    TracksInView,
    Travel,
    Tuber,
    View,
)
from conveyor.node import Node
from viewer.scene.profiles import Profile

FRAME_RING = 2
VIEW_RING = 64
TRAVEL_RING = 64
TRACK_RING = 1024
IN_VIEW_RING = 32
TUBER_INBOX = 8192
POSITION_RING = 64


class Inputs:
    """All subscribers of one viewer. Cameras are found while running: each has a ring of its own."""

    def __init__(self, node: Node, profile: Profile) -> None:
        self._node = node
        self._pictures = profile.pictures
        self._frames_of = topics.FRAME_FEW if profile.rate_hz <= topics.FEW_PER_S else topics.FRAME
        self.frames: dict[str, Inbox[Frame]] = {}
        self.views: Inbox[View] | None = None
        if profile.pictures:
            self.views = LatestSubscriber(node, topics.VIEW, View, capacity=VIEW_RING, regressor="*")
        self.travel: Inbox[Travel] = LatestSubscriber(node, topics.TRAVEL, Travel, capacity=TRAVEL_RING, source="*")
        self.tracks: Inbox[TrackEntry] = ReliableSubscriber(
            node, topics.TRACK, TrackEntry, capacity=TRACK_RING, history=False, camera="*"
        )
        self.in_view: Inbox[TracksInView] = LatestSubscriber(
            node, topics.IN_VIEW, TracksInView, capacity=IN_VIEW_RING, camera="*"
        )
        self.tubers: Inbox[Tuber] = ReliableSubscriber(node, topics.TUBER, Tuber, capacity=TUBER_INBOX)
        self.positions: Inbox[Position] = LatestSubscriber(
            node, topics.POSITION, Position, capacity=POSITION_RING, receiver="*"
        )
        self.infos = KeptSubscriber(node, topics.CAMERA_INFO, CameraInfo, camera="*")
        self.totals = KeptSubscriber(node, topics.TOTALS, Totals)
        self.counters = KeptSubscriber(node, topics.COUNTERS, Counters, role="*", name="*")
        self._presence = {role: Presence(node, role) for role in topics.ALIVE.senders}

    def follow(self, camera: str) -> None:
        """Subscribe to the frames of a camera that showed up."""
        if self._pictures and camera not in self.frames:
            self.frames[camera] = LatestSubscriber(
                self._node, self._frames_of, Frame, capacity=FRAME_RING, name=f"frame_{camera}", camera=camera
            )

    def alive(self) -> set[str]:
        """'role/name' of every node whose token is there."""
        return {f"{role}/{name}" for role, presence in self._presence.items() for name in presence.names()}
