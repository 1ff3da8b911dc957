"""Our MCAP recordings: a channel per camera, a message per frame, as it goes over the wire.

Topic `camera/<camera>/frame`, message encoding `tuberline`, log time = capture time, MCAP sequence = frame number.
Chunks are compressed with zstd. `truth.json`, `line.json` and `positions.csv` of a folder recording travel as
attachments. The metadata record `tuberline.format` states the format's version; a file without one is version 1.
"""

from __future__ import annotations

import re

PROFILE = "tuberline"
FORMAT_VERSION = 1
FORMAT_METADATA, FORMAT_NAME = "tuberline.format", "MCAP recording"
ENCODING = "tuberline"
SCHEMA_NAME = "tuberline.Frame"
SCHEMA_ENCODING = "text"
SCHEMA_TEXT = b"""One tuberline Frame message, schema version 1.

bytes 0-3    magic "TBL" and the schema version (uint8)
bytes 4-7    length of the header, little-endian uint32
header       MessagePack map {"kind": "Frame", "fields": {...}, "arrays": [{"name", "dtype", "shape", "codec", "size"}]}
then         the arrays' bytes, one after the other, in the header's order; codec "raw" or "zstd"

fields: camera, run, seq, captured_ns (camera clock), travel_m (belt travel, metres, or null), depth_scale_m (metres per
depth unit), intrinsics {width, height, fx, fy, cx, cy} in pixels, belt_distance_m (or null).
arrays: depth u2 (H, W), 0 = no depth; optional belt_from_camera f8 (4, 4), mask u2 (H, W), color_jpeg u1 (n,).
Little-endian, C order.
"""
ATTACHMENTS = ("truth.json", "line.json", "positions.csv")
_TOPIC = re.compile(r"camera/([A-Za-z0-9][A-Za-z0-9._-]{0,63})/frame")


def topic_of(camera: str) -> str:
    """Topic of a camera's channel."""
    return f"camera/{camera}/frame"


def camera_of(topic: str) -> str | None:
    """Camera of a channel, None for channels of another kind."""
    match = _TOPIC.fullmatch(topic)
    return match.group(1) if match else None
