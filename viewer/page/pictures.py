"""The newest pictures of the cameras that somebody looks at, asked for while a browser shows them and no longer."""

from __future__ import annotations

import base64
import json
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Self

from conveyor import topics
from conveyor.delivery import LatestSubscriber
from conveyor.messages import Picture
from conveyor.observer import Observer
from conveyor.topics import check_name

Camera = tuple[str, str]
"""Line and camera."""
POLL_S = 0.05
IDLE_S = 0.2
INBOX = 2


class Pictures:
    """Who is looked at, and the newest picture of each, as an event for browsers. From any thread."""

    def __init__(self) -> None:
        self.on_change: Callable[[], None] = lambda: None
        self._lock = threading.Lock()
        self._lookers: Counter[Camera] = Counter()
        self._newest: dict[Camera, tuple[int, float, str]] = {}
        self._number = 0

    def look(self, cameras: Iterable[Camera]) -> None:
        """One more browser shows these cameras."""
        with self._lock:
            self._lookers.update(cameras)

    def leave(self, cameras: Iterable[Camera]) -> None:
        """One browser less; what no one looks at is forgotten."""
        with self._lock:
            self._lookers.subtract(cameras)
            for camera in [camera for camera, n in self._lookers.items() if n <= 0]:
                del self._lookers[camera]
                self._newest.pop(camera, None)

    def wanted(self, line: str) -> set[str]:
        """Cameras of a line that somebody looks at."""
        with self._lock:
            return {camera for of, camera in self._lookers if of == line}

    def put(self, line: str, picture: Picture) -> None:
        """Keep a picture, if someone still looks."""
        came_s, told = time.monotonic(), _told(line, picture)
        with self._lock:
            if (line, picture.camera) not in self._lookers:
                return
            self._number += 1
            self._newest[line, picture.camera] = (self._number, came_s, told)
        self.on_change()

    def newest(self, camera: Camera, *, after: int = 0) -> tuple[int, bytes]:
        """(number, event); the number rises with each picture, and is 0 before the first one. No event up to `after`.

        The event says how old the picture is, for a browser that comes later gets one that is long past, and when it
        is sent (`sent_s`, monotonic), for it may wait on the link.
        """
        with self._lock:
            number, came_s, told = self._newest.get(camera, (0, 0.0, ""))
        if number <= after:
            return number, b""
        now_s = time.monotonic()
        return number, f'data: {{"age_s":{now_s - came_s:.1f},"sent_s":{now_s:.2f},{told}\n\n'.encode()


def camera_of(asked: str) -> Camera:
    """Line and camera of 'LINE/CAMERA'; raises ConfigError where these are no names."""
    line, _, camera = asked.partition("/")
    return check_name(line, what="line"), check_name(camera, what="camera")


def _told(line: str, picture: Picture) -> str:
    """What is told of a picture but its age, as the rest of a JSON object."""
    told = {
        "line": line,
        "camera": picture.camera,
        "seq": picture.seq,
        "width": picture.width,
        "height": picture.height,
        "drop": picture.drop,
        "outlines": [
            [each.state, None if each.weight_g is None else round(each.weight_g), each.corners]
            for each in picture.outlines
        ],
        "jpeg": base64.b64encode(picture.jpeg.tobytes()).decode(),
    }
    return json.dumps(told, separators=(",", ":")).removeprefix("{")


class PictureWatch:
    """Subscribes to a line's cameras while somebody looks at them, on its own thread. A context manager."""

    def __init__(self, observer: Observer, pictures: Pictures) -> None:
        self._observer = observer
        self._pictures = pictures
        self._inboxes: dict[str, LatestSubscriber[Picture]] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name=f"pictures-{observer.line}", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join(1.0)

    def _watch(self) -> None:
        asked_s = -IDLE_S
        while not self._stop.wait(POLL_S if self._inboxes else IDLE_S):
            if time.monotonic() - asked_s >= IDLE_S:
                asked_s = time.monotonic()
                self._follow(self._pictures.wanted(self._observer.line))
            for camera, inbox in self._inboxes.items():
                newest = None
                while len(inbox):
                    newest = inbox.get(0.0) or newest
                if newest is not None and newest.camera == camera:
                    self._pictures.put(self._observer.line, newest)

    def _follow(self, wanted: set[str]) -> None:
        for camera in self._inboxes.keys() - wanted:
            self._inboxes.pop(camera).leave()
        for camera in wanted - self._inboxes.keys():
            self._inboxes[camera] = LatestSubscriber(
                self._observer, topics.PICTURE, Picture, capacity=INBOX, camera=camera
            )
