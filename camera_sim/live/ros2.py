"""A depth camera of a ROS 2 system, heard over Zenoh: no ROS is needed here, only rmw_zenoh on the other side."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, TypeVar

import zenoh

from camera_sim.live.rmw_zenoh import Attachment, Numbering, check_topic, key_of, published_topic, read_attachment
from camera_sim.live.ros2_calibration import INFO, Calibrations
from conveyor.config import LinkConfig
from conveyor.config_camera import CameraConfig
from conveyor.errors import ConfigError, DeviceError, InputError, MessageError
from conveyor.formats.mcap.reader import rate_of
from conveyor.formats.png16 import Refusal
from conveyor.formats.rosbag.bags import decode_ros, ros2_typestore
from conveyor.formats.rosbag.depth import (
    FLOAT_ENCODING,
    depth_encoding,
    depth_pixels,
    intrinsics_of,
    unit_m,
    unsupported,
)
from conveyor.formats.rosbag.messages import RosCalibration, RosCompressed, RosImage
from conveyor.formats.scale_check import ScaleCheck
from conveyor.formats.source import CameraDescription, Refused
from conveyor.messages import Frame
from conveyor.session import ENCRYPTED, open_client

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
FIRST_WITHIN_S = 10.0
RATE_FROM_IMAGES, RATE_WITHIN_S = 5, 2.0
RING = 8
"""Newest images kept while this process is busy; what is pushed out is a gap in the numbers."""
POLL_S = 0.2

T = TypeVar("T")


@dataclass(slots=True)
class _Inbox:
    """Samples as they arrive; Zenoh's thread only copies and queues."""

    samples: deque[tuple[bytes, bytes]] = field(default_factory=lambda: deque(maxlen=RING))
    arrived: threading.Condition = field(default_factory=threading.Condition)

    def push(self, sample: Any) -> None:
        attachment = sample.attachment.to_bytes() if sample.attachment is not None else b""
        with self.arrived:
            self.samples.append((sample.payload.to_bytes(), attachment))
            self.arrived.notify_all()

    def take(self, timeout_s: float) -> tuple[bytes, bytes] | None:
        with self.arrived:
            self.arrived.wait_for(lambda: self.samples, timeout_s)
            return self.samples.popleft() if self.samples else None

    def look(self, ready: Callable[[list[tuple[bytes, bytes]]], T | None], timeout_s: float) -> T | None:
        """What `ready` makes of the samples that are there, as soon as it is something; they stay."""
        deadline = time.monotonic() + timeout_s
        with self.arrived:
            while (value := ready(list(self.samples))) is None:
                left = deadline - time.monotonic()
                if left <= 0 or not self.arrived.wait(left):
                    return None
            return value


class Ros2Source:
    """Depth images of one ROS 2 topic with their CameraInfo, numbered as their publisher numbers them."""

    _description: CameraDescription

    def __init__(self, name: str, settings: CameraConfig, session: Any) -> None:
        if settings.topic is None:
            raise ConfigError(
                f"cameras.{name}: source 'ros2' needs its topic, e.g. topic = '/camera/camera/depth/image_rect_raw'"
            )
        self._name = name
        self._settings = settings
        self._session = session
        self._topic = check_topic(settings.topic)
        base = self._topic.removesuffix("/compressedDepth")
        self._info_topic = check_topic(settings.info_topic or f"{base.rpartition('/')[0]}/camera_info")
        self._type = COMPRESSED if base != self._topic else IMAGE
        self._images, self._infos = _Inbox(), _Inbox()
        self._subscribers: list[Any] = []
        self._calibrations = Calibrations(self._info_topic, rectified="rect" in self._topic)
        self._scale = ScaleCheck(f"ROS topic {self._topic}")
        self._poll: Callable[[float], bool] = lambda still_s: True

    @classmethod
    def connect(cls, name: str, settings: CameraConfig, link: LinkConfig) -> Ros2Source:
        """Listen until camera and calibration are known.

        Raises:
            LinkError: no router there.
            DeviceError: nothing is published on the topic or its CameraInfo; the text lists the image topics there are.
        """
        ros2_typestore()  # a missing package is said before anything is waited for
        session = open_client(_ros_link(settings, link), name=f"camera/{name}")
        try:
            source = cls(name, settings, session)
            source._listen()
        except BaseException:
            session.close()  # type: ignore[no-untyped-call, unused-ignore]
            raise
        return source

    @property
    def description(self) -> CameraDescription:
        """From CameraInfo and the first images."""
        return self._description

    def attach(self, poll: Callable[[float], bool]) -> None:
        """While nothing comes, `poll` is told several times a second for how long (seconds); False ends the frames."""
        self._poll = poll

    def frames(self, *, run: str, after: int = -1) -> Iterator[Frame | Refused]:
        """Frames as they come. The first one is number `after` + 1, then the publisher's own steps.

        Each has the intrinsics that CameraInfo says at its time: a driver that starts again in another mode sends other
        frames than the run began with, which the segmenter refuses.
        """
        numbering = Numbering(after=after, fps=self._description.fps)
        last_s = time.monotonic()
        try:
            while self._poll(time.monotonic() - last_s):
                sample = self._images.take(POLL_S)
                while (info := self._infos.take(0.0)) is not None:
                    self._calibrations.take(*info)
                if sample is not None:
                    last_s = time.monotonic()
                    item = self._item(numbering, *sample, run)
                    if item is not None:
                        yield item
        finally:
            self._session.close()

    def _item(self, numbering: Numbering, payload: bytes, extra: bytes, run: str) -> Frame | Refused | None:
        """The frame of a sample; None for one that came twice or too late, whose number is a gap already."""
        try:
            attachment = read_attachment(extra)
        except MessageError as error:
            return Refused(numbering.refused(), "no_attachment", f"a message on {self._topic}: {error}")
        image, fault = self._decoded(payload)
        captured_ns = (image and image.stamp_ns) or attachment.sent_ns
        try:
            seq = numbering.number(attachment, captured_ns)
        except ConfigError as error:
            return Refused(numbering.refused(), "two_publishers", f"a message on {self._topic}: {error}")
        if seq is None:
            return None
        if image is None:
            return Refused(seq, "undecodable", f"frame {seq} of {self._topic}: {fault}")
        return self._frame(image, seq, captured_ns, run, attachment)

    def _decoded(self, payload: bytes) -> tuple[RosImage | RosCompressed | None, str]:
        """(the image, ""), or (None, why it is none)."""
        try:
            image = decode_ros(self._type, payload)
        except MessageError as error:
            return None, str(error)
        assert isinstance(image, RosImage | RosCompressed)
        return image, ""

    def _frame(
        self, image: RosImage | RosCompressed, seq: int, captured_ns: int, run: str, attachment: Attachment
    ) -> Frame | Refused:
        d, where = self._description, f"frame {seq} of {self._topic}"
        k = self._calibrations.of_image(image.stamp_ns, publisher=attachment.gid)
        if isinstance(k, Refusal):
            return Refused(seq, k.reason, f"{where} {k.text}")
        depth = depth_pixels(image)
        if isinstance(depth, Refusal):
            return Refused(seq, depth.reason, f"{where} {depth.text}")
        if (depth_encoding(image) == FLOAT_ENCODING) != self._in_metres:
            return Refused(seq, "encoding", f"{where} has encoding '{depth_encoding(image)}', unlike the first image")
        if depth.shape != (k.height, k.width):
            size = f"{depth.shape[1]}x{depth.shape[0]}"
            return Refused(seq, "wrong_size", f"{where} is {size}, its CameraInfo says {k.width}x{k.height}")
        frame = Frame(
            camera=d.name,
            run=run,
            seq=seq,
            captured_ns=captured_ns,
            travel_m=None,
            depth_scale_m=d.depth_scale_m,
            intrinsics=k,
            belt_distance_m=d.belt_distance_m,
            depth=depth,
        )
        return self._scale.refusal(frame) or frame

    def _listen(self) -> None:
        domain = self._settings.ros_domain
        for topic, type_name, inbox in ((self._topic, self._type, self._images), (self._info_topic, INFO, self._infos)):
            key = key_of(topic, type_name, domain=domain)
            handler = zenoh.handlers.Callback(inbox.push, indirect=False)
            self._subscribers.append(self._session.declare_subscriber(key, handler))
        first = self._images.look(lambda samples: samples[0][0] if samples else None, FIRST_WITHIN_S)
        if first is None:
            raise DeviceError(self._silence(self._topic, "images"))
        info = self._infos.look(lambda samples: samples[0][0] if samples else None, FIRST_WITHIN_S)
        if info is None:
            raise DeviceError(self._silence(self._info_topic, "CameraInfo"))
        self._description = self._describe(first, info)

    def _describe(self, first: bytes, info: bytes) -> CameraDescription:
        where = f"camera '{self._name}': ROS topic {self._topic}"
        try:
            image, calibration = decode_ros(self._type, first), decode_ros(INFO, info)
        except MessageError as error:
            raise InputError(f"{where}: {error}") from error
        assert isinstance(image, RosImage | RosCompressed)
        assert isinstance(calibration, RosCalibration)
        self._calibrations.take(info)
        fault = unsupported(image)
        if fault:
            raise InputError(f"{where} {fault}")
        self._in_metres = depth_encoding(image) == FLOAT_ENCODING
        if self._in_metres and self._settings.depth_scale_m is not None:
            raise ConfigError(f"cameras.{self._name}: {self._topic} is in metres; remove depth_scale_m")
        return CameraDescription(
            name=self._name,
            origin=f"ROS 2 topic {self._topic}, domain {self._settings.ros_domain}, over Zenoh",
            intrinsics=intrinsics_of(calibration, rectified="rect" in self._topic, where=f"topic {self._info_topic}"),
            depth_scale_m=self._settings.depth_scale_m or unit_m(image),
            belt_distance_m=self._settings.belt_distance_m,
            belt_from_camera=None,
            fps=self._rate(),
            frames=None,
            live=True,
        )

    def _rate(self) -> float:
        """Frames per second from the time stamps of the first images."""
        self._images.look(lambda samples: True if len(samples) >= RATE_FROM_IMAGES else None, RATE_WITHIN_S)
        times = []
        for payload, _ in self._images.look(lambda samples: samples, 0.0) or []:
            try:
                image = decode_ros(self._type, payload)
            except MessageError:
                continue  # refused by name when its turn comes
            if isinstance(image, RosImage | RosCompressed):
                times.append(image.stamp_ns)
        return rate_of(times)

    def _silence(self, topic: str, what: str) -> str:
        domain = self._settings.ros_domain
        found = {f"{name} ({kind})" for name, kind in _image_topics(self._session, domain)}
        return (
            f"camera '{self._name}': no {what} on ROS topic {topic} (domain {domain}) within {FIRST_WITHIN_S:g} s; "
            f"image topics published there: {', '.join(sorted(found)) or 'none'}. Is the driver running with "
            "RMW_IMPLEMENTATION=rmw_zenoh_cpp, and is ros_router its router?"
        )


def published_depth(link: LinkConfig, domain: int) -> list[str]:
    """Topics of depth images that nodes behind the router of `link` publish, by their names.

    Raises:
        LinkError: no router answers there.
    """
    with open_client(link, name="init") as session:
        topics = _image_topics(session, domain)
    depths = {name for name, kind in topics if kind in (IMAGE, COMPRESSED) and "depth" in name}
    return sorted(name for name in depths if not name.endswith(("/compressed", "/theora")))


def _image_topics(session: Any, domain: int) -> set[tuple[str, str]]:
    """(topic, type) of the images and camera infos that are published."""
    found = set()
    for reply in session.liveliness().get(f"@ros2_lv/{domain}/**", timeout=2.0):
        published = published_topic(str(reply.ok.key_expr)) if reply.ok is not None else None
        if published and published[1] in (IMAGE, COMPRESSED, INFO):
            found.add((published[0], published[1]))
    return found


def _ros_link(settings: CameraConfig, link: LinkConfig) -> LinkConfig:
    """The line's own router, or the one that the ROS nodes use; certificates only go where the link is encrypted."""
    if settings.ros_router is None:
        return link
    keep = {"router": settings.ros_router, "listen": ()}
    if settings.ros_router.startswith(ENCRYPTED):
        return link.model_copy(update=keep)
    nothing = {"root_ca": None, "certificate": None, "private_key": None, "certs": None}
    return link.model_copy(update={**keep, **nothing})
