"""A depth camera of a ROS 2 system as rmw_zenoh puts it on the wire: keys, CDR, attachments, liveliness tokens."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from conveyor.config import LinkConfig
from conveyor.session import open_client
from tests.formats.bag_messages import COMPRESSED, IMAGE, INFO, STORE

QOS = "::,10:,:,:,,"


class Ros2Camera:
    """A node that publishes images on `topic` and their CameraInfo beside it."""

    def __init__(self, session: Any, topic: str, *, gid: bytes, domain: int = 0) -> None:
        self._gid = gid
        self._sequence = 0
        kind = COMPRESSED if topic.endswith("compressedDepth") else IMAGE
        info_topic = topic.removesuffix("/compressedDepth").rpartition("/")[0] + "/camera_info"
        self._tokens = [
            session.liveliness().declare_token(
                f"@ros2_lv/{domain}/{gid.hex()}/0/{n}/MP/%/%/driver/{name.replace('/', '%')}/{_wire(of)}/{QOS}"
            )
            for n, (name, of) in enumerate(((topic, kind), (info_topic, INFO)))
        ]
        self._images = session.declare_publisher(f"{domain}{topic}/{_wire(kind)}")
        self._infos = session.declare_publisher(f"{domain}{info_topic}/{_wire(INFO)}")

    def publish(self, image: bytes, info: bytes, *, skip: int = 0) -> None:
        """One image with its info; `skip` images before it get lost on the way."""
        self._sequence += 1 + skip
        attachment = struct.pack("<qqB", self._sequence, 1_700_000_000_000_000_000, 16) + self._gid
        self._infos.put(info, attachment=attachment)
        self._images.put(image, attachment=attachment)

    def stop(self) -> None:
        """As a node that ends."""
        for declared in (*self._tokens, self._images, self._infos):
            declared.undeclare()


@contextmanager
def ros2_session(link: LinkConfig) -> Iterator[Any]:
    """The session of a ROS 2 process."""
    session = open_client(link, name="ros2")
    try:
        yield session
    finally:
        session.close()


def _wire(type_name: str) -> str:
    package, middle, name = type_name.split("/")
    return f"{package}::{middle}::dds_::{name}_/{STORE.hash_rihs01(type_name)}"
