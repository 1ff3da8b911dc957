"""Every message that crosses a process boundary. `conveyor.topics` says which topic carries which."""

from conveyor.messages.base import Message
from conveyor.messages.frames import CameraInfo, Frame, FrameProgress, Travel
from conveyor.messages.loads import LoadAnswer, LoadNow, LoadOrder
from conveyor.messages.positions import Position
from conveyor.messages.reports import Counters, Totals, Tuber
from conveyor.messages.tracks import Committed, Mark, Track, TrackEntry, WeighedView
from conveyor.messages.views import View, Weight

__all__ = [
    "CameraInfo",
    "Committed",
    "Counters",
    "Frame",
    "FrameProgress",
    "LoadAnswer",
    "LoadNow",
    "LoadOrder",
    "Mark",
    "Message",
    "Position",
    "Totals",
    "Track",
    "TrackEntry",
    "Travel",
    "Tuber",
    "View",
    "WeighedView",
    "Weight",
]
