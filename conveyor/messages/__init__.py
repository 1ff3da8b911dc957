"""Every message that crosses a process boundary. `conveyor.topics` says which topic carries which."""

from conveyor.messages.apart import CamerasApart
from conveyor.messages.base import Message
from conveyor.messages.classes import ClassTotal
from conveyor.messages.exchanged import CameraExchanged
from conveyor.messages.foreign import ForeignTotal
from conveyor.messages.frames import CameraInfo, Frame, FrameProgress, FrameSlot, Travel
from conveyor.messages.heights import HeightChange
from conveyor.messages.in_view import TrackInView, TracksInView
from conveyor.messages.loads import LoadAnswer, LoadNow, LoadOrder
from conveyor.messages.pictures import Outline, Picture
from conveyor.messages.positions import Position
from conveyor.messages.reports import Counters, Totals, Tuber
from conveyor.messages.sizes import Sizes
from conveyor.messages.tracks import Committed, Mark, Track, TrackEntry, WeighedView
from conveyor.messages.views import View, Weight

__all__ = [
    "CameraExchanged",
    "CameraInfo",
    "CamerasApart",
    "ClassTotal",
    "Committed",
    "Counters",
    "ForeignTotal",
    "Frame",
    "FrameProgress",
    "FrameSlot",
    "HeightChange",
    "LoadAnswer",
    "LoadNow",
    "LoadOrder",
    "Mark",
    "Message",
    "Outline",
    "Picture",
    "Position",
    "Sizes",
    "Totals",
    "Track",
    "TrackEntry",
    "TrackInView",
    "TracksInView",
    "Travel",
    "Tuber",
    "View",
    "WeighedView",
    "Weight",
]
