"""How ROS 2 nodes speak over Zenoh with rmw_zenoh: keys, attachments, liveliness tokens. No sockets here.

Source: the design document and attachment_helpers.cpp of ros2/rmw_zenoh. A publisher's key is
`<domain>/<topic without its first slash>/<DDS type>/<type hash>`; the payload is CDR with its four bytes of
encapsulation; the attachment is the sequence number and the source time stamp (int64 each, little-endian), the length
of the GID (one byte, 16) and the publisher's GID. A publisher's liveliness token is
`@ros2_lv/<domain>/<session>/<node>/<entity>/MP/<enclave>/<namespace>/<node name>/<topic>/<DDS type>/<hash>/<QoS>`
with `%` for the slashes of a name.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from conveyor.errors import ConfigError, MessageError
from conveyor.formats.rosbag.messages import plain_type

ATTACHMENT = struct.Struct("<qqB16s")
GID_BYTES = 16
PUBLISHER = "MP"


@dataclass(frozen=True, slots=True)
class Attachment:
    """What rmw_zenoh says about a message: its number of this publisher (from 1), when it was sent, by whom."""

    sequence: int
    sent_ns: int
    gid: bytes


def read_attachment(data: bytes) -> Attachment:
    """The attachment of a message.

    Raises:
        MessageError: it is none of rmw_zenoh.
    """
    if len(data) != ATTACHMENT.size:
        raise MessageError(f"its attachment has {len(data)} bytes, those of rmw_zenoh have {ATTACHMENT.size}")
    sequence, sent_ns, length, gid = ATTACHMENT.unpack(data)
    if length != GID_BYTES:
        raise MessageError(f"its attachment has a GID of {length} bytes, those of rmw_zenoh have {GID_BYTES}")
    return Attachment(sequence, sent_ns, gid)


def key_of(topic: str, type_name: str, *, domain: int, type_hash: str = "*") -> str:
    """Key of a topic's publishers; any hash of the type by default, for it differs between ROS distributions."""
    return f"{domain}/{topic.strip('/')}/{dds_type(type_name)}/{type_hash}"


def dds_type(type_name: str) -> str:
    """'sensor_msgs/msg/Image' is 'sensor_msgs::msg::dds_::Image_' on the wire."""
    package, middle, name = type_name.split("/")
    return f"{package}::{middle}::dds_::{name}_"


def check_topic(topic: str) -> str:
    """The topic, as ROS writes it with its first slash.

    Raises:
        ConfigError: no ROS topic name.
    """
    parts = topic.strip("/").split("/")
    if not all(part and part.replace("_", "a").isalnum() and part.isascii() for part in parts):
        raise ConfigError(f"'{topic}' is no ROS topic; write it in full, e.g. /camera/camera/depth/image_rect_raw")
    return "/" + "/".join(parts)


def published_topic(token: str) -> tuple[str, str] | None:
    """(topic, type) of a publisher's liveliness token; None for tokens of another kind."""
    parts = token.split("/")
    if len(parts) < 13 or parts[5] != PUBLISHER:
        return None
    return parts[9].replace("%", "/"), plain_type(parts[10])


class Numbering:
    """Frame numbers from a publisher's sequence numbers, so that what is lost on the way leaves a gap.

    A publisher that starts again counts from 1 and has another GID: its first frame gets the number that its time
    stamp and the frame rate say, so that the belt that passed meanwhile is a gap too. Two at once are an error.
    """

    LONGEST_S = 600.0

    def __init__(self, *, after: int, fps: float) -> None:
        self._newest = after
        self._fps = fps
        self._gid: bytes | None = None
        self._offset = 0
        self._newest_ns = 0
        self._gone: set[bytes] = set()

    def number(self, attachment: Attachment, captured_ns: int) -> int | None:
        """The frame's number; None for one that is not newer than the newest.

        Raises:
            ConfigError: two nodes publish on the topic.
        """
        if attachment.gid != self._gid:
            self._change(attachment, captured_ns)
        seq = attachment.sequence + self._offset
        if seq <= self._newest:
            return None
        self._newest, self._newest_ns = seq, captured_ns
        return seq

    def refused(self) -> int:
        """A number for a message without a usable one."""
        self._newest += 1
        self._offset += 1
        return self._newest

    def _change(self, attachment: Attachment, captured_ns: int) -> None:
        if attachment.gid in self._gone:
            raise ConfigError("two ROS nodes publish on the topic at once; stop one of them or give them other names")
        missed = 0
        if self._gid is not None:
            self._gone.add(self._gid)
            away_s = min(max((captured_ns - self._newest_ns) / 1e9, 0.0), self.LONGEST_S)
            missed = max(0, round(away_s * self._fps) - 1)
        self._gid = attachment.gid
        self._offset = self._newest + 1 + missed - attachment.sequence
