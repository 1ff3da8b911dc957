"""Frames that stay on their host: a link of its own between a camera and its segmenter, beside the router.

A frame of 1.8 MB that passes the router is received and sent once more, and a site's network ends at nine cameras. So
where both ends run on one host, the segmenter listens on a socket of that host and the camera connects to it. Nothing
but that camera's frames passes there; everything else, and frames for who looks from beyond, goes by the router.
The link is there or it is not: the segmenter takes no frames from the router meanwhile, and what it missed shows in
their numbers, as on any link.
"""

from __future__ import annotations

import json
import logging
import os
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import zenoh

from conveyor.config import LinkConfig
from conveyor.config_camera import CameraConfig
from conveyor.counters import CounterSet
from conveyor.delivery.endpoint import Endpoint
from conveyor.errors import LinkError
from conveyor.session import common_settings, short_reason

ENVIRONMENT = "TUBERLINE_DIRECT"
"""Folder in which the segmenters that `tuberline run` and `replay` start listen: theirs alone, by its rights."""
UNIX = "unixsock-stream/"
LONGEST_PATH = 100
"""Bytes of a socket's path; Linux allows 108, and Zenoh adds `.lock` to it."""
RETRY = {"period_init_ms": 20, "period_max_ms": 200, "period_increase_factor": 1.5}


def direct_endpoint(camera: CameraConfig, name: str) -> str | None:
    """Where the segmenter of camera `name` listens for its frames; None where they pass the router."""
    if camera.direct != "auto":
        return None if camera.direct == "off" else camera.direct
    folder = os.environ.get(ENVIRONMENT)
    if not folder:
        return None
    path = Path(folder) / f"{name}.sock"
    return f"{UNIX}{path}" if len(os.fsencode(path)) <= LONGEST_PATH else None


@dataclass(slots=True)
class DirectLink:
    """One end of the link, an `Endpoint` as a node is. A context manager: its session must be closed."""

    session: zenoh.Session
    line: str
    counters: CounterSet
    log: logging.Logger

    @classmethod
    def open(cls, node: Endpoint, endpoint: str, *, link: LinkConfig, listens: bool) -> Self:
        """The end of `node`; who connects does so in the background, again and again, for as long as it lives.

        Raises:
            LinkError: the socket is taken or cannot be made.
        """
        settings = common_settings(link)
        settings["scouting"]["delay"] = 0  # there is no one to be found
        if listens:
            settings["listen"] = {"endpoints": [endpoint]}
        else:
            settings["listen"] = {"endpoints": []}
            settings["connect"] = {"endpoints": [endpoint], "timeout_ms": -1, "exit_on_failure": False, "retry": RETRY}
        try:
            # Two peers and nothing between them: peers relay for no one.
            session = zenoh.open(zenoh.Config.from_json5(json.dumps({"mode": "peer", **settings})))
        except zenoh.ZError as error:
            raise LinkError(
                f"the direct link {endpoint} cannot be opened: {short_reason(error)}; does another segmenter of this "
                'camera run here? Frames pass the router with direct = "off"'
            ) from error
        return cls(session, node.line, node.counters, node.log)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.session.close()  # type: ignore[no-untyped-call, unused-ignore]
        except zenoh.ZError as failure:
            self.log.warning("the direct link did not close: %s", failure)
