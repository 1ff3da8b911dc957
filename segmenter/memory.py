"""What is known of a camera from one run to the next, over restarts: who starts need not learn it again."""

from __future__ import annotations

import hashlib
import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgpack
import numpy as np

from conveyor.config import LineConfig
from conveyor.errors import InputError
from conveyor.files import replacing, told
from conveyor.geometry import Intrinsics
from segmenter.classify.prior import NEWEST, SHARES, Prior
from segmenter.first_look import look_first
from segmenter.known import Known
from segmenter.outline.compare import Comparison
from segmenter.outline.flanks import BINS

VERSION = 1
KEEP_EVERY_S = 60.0


class CameraMemory:
    """What is known of one camera of one line, for its next run: of a live one by its file, of a recording by a look.

    Losing it costs some twenty tubers' time, so no fault of the file stops anything: each is logged, and the camera is
    learned afresh.
    """

    def __init__(self, config: LineConfig, camera: str, log: logging.Logger) -> None:
        self._config = config
        self._camera = camera
        folder = config.segmenter.state_dir
        self._live = not config.camera(camera).held_back
        self._path = folder / f"{config.name}.{camera}.known" if self._live and folder is not None else None
        self._settings = _settings_of(config, camera)
        self._log = log
        self._run = ""
        self._known: Known | None = None
        self._looked = False
        self._writer: threading.Thread | None = None
        self._kept_s: float | None = None
        self._failed = False

    def look(self, *, go_on: Callable[[], bool]) -> None:
        """Look at the camera's recording, where the config asks for that; else read what an earlier process kept."""
        look = look_first(self._config, self._camera, go_on=go_on)
        if look is None:
            self._read()
            return
        self._looked, self._known = True, look.known
        self._log.info(
            "looked at %d frames of the recording first, in which %d bodies passed", look.frames, look.bodies
        )

    def known_in(self, run: str) -> Known | None:
        """What is known of the camera as `run` begins. On another day's belt nothing is known of clods yet."""
        same = self._looked or run == self._run
        return self._known if same or self._known is None else self._known.of_the_camera()

    def due(self, now_s: float) -> bool:
        """It is time to keep what is known, and the last was written."""
        if self._kept_s is None:
            self._kept_s = now_s
        writes = self._writer is not None and self._writer.is_alive()
        return self._path is not None and now_s - self._kept_s >= KEEP_EVERY_S and not writes

    def keep(self, known: Known | None, run: str, now_s: float) -> None:
        """Write it down beside the frames: a disk that is slow stops none."""
        self._kept_s = now_s
        if self._path is not None and known is not None and known.outlines:
            self._writer = threading.Thread(target=self._write, args=(self._path, known, run), daemon=True)
            self._writer.start()

    def over(self, known: Known | None, run: str) -> None:
        """A run ends, or the process does: write down the last of it."""
        if self._writer is not None:
            self._writer.join()
        if self._live and known is not None and known.outlines:
            self._known, self._run = known, run
            if self._path is not None:
                self._write(self._path, known, run)

    def _read(self) -> None:
        if self._path is None:
            return
        try:
            raw = msgpack.unpackb(self._path.read_bytes())
            if raw["version"] != VERSION:
                return
            if raw["settings"] != self._settings:
                self._log.info("the camera's settings have changed: what it does to outlines is learned afresh")
                return
            self._known, self._run = _known(raw), str(raw["run"])
        except FileNotFoundError:
            return
        except OSError as error:
            self._log.warning("what was known of the camera cannot be read: %s", told(error, self._path))
        except (ValueError, KeyError, TypeError, InputError, msgpack.UnpackException):
            self._log.warning("%s is damaged: what the camera does to outlines is learned afresh", self._path)

    def _write(self, path: Path, known: Known, run: str) -> None:
        packed = msgpack.packb({"version": VERSION, "settings": self._settings, "run": run, **_plain(known)})
        try:
            with replacing(path) as file:
                file.write(packed)
            self._failed = False
        except OSError as error:
            if not self._failed:
                self._log.warning("what is known of the camera is not kept for the next start: %s", told(error, path))
            self._failed = True


def _settings_of(config: LineConfig, camera: str) -> str:
    """Of all that decides what outlines and distances look like."""
    belt, encoder = config.belt.model_dump_json(), config.encoder.model_dump_json() if config.encoder else ""
    parts = (config.camera(camera).model_dump_json(), belt, encoder, str(config.segmenter.pixel_mm))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def _plain(known: Known) -> dict[str, Any]:
    return {
        "intrinsics": asdict(known.intrinsics),
        "depth_scale_m": known.depth_scale_m,
        "belt_distance_m": known.belt_distance_m,
        "outlines": [[(c.lost_px, c.apart_m, c.px_per_m, c.slip_m) for c in tuber] for tuber in known.outlines],
        "flanks_mm": known.flanks_mm.tolist(),
        "belt": {"said": known.belt.said.tolist(), "newest": list(known.belt.newest)},
    }


def _known(raw: dict[str, Any]) -> Known:
    outlines = tuple(
        tuple(
            Comparison(tuple(map(float, lost_px)), float(apart_m), float(px_per_m), slip_m)
            for lost_px, apart_m, px_per_m, slip_m in tuber
        )
        for tuber in raw["outlines"]
    )
    said = np.array(raw["belt"]["said"], np.float64).reshape(SHARES)
    return Known(
        intrinsics=Intrinsics(**raw["intrinsics"]),
        depth_scale_m=float(raw["depth_scale_m"]),
        belt_distance_m=float(raw["belt_distance_m"]),
        outlines=outlines,
        flanks_mm=np.array(raw["flanks_mm"], np.float64).reshape(-1, BINS),
        belt=Prior(said, deque(map(float, raw["belt"]["newest"]), maxlen=NEWEST)),
    )
