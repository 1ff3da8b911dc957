"""A small line for the viewer's tests: a router, a belt of ellipsoids with known weights, publishers, a viewer."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conveyor.config import LinkConfig
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import CameraInfo, Frame, Totals, TrackInView, TracksInView, Tuber, View
from conveyor.observer import Observer
from conveyor.taken_port import free_port

RUN = "load-7"
BELT_DISTANCE_M = 0.46
SCALE_M = 0.0001
LENS = Intrinsics(424, 240, 280.0, 280.0, 211.5, 119.5)
SPEED_MPS = 0.3
FPS = 30.0
BUSY = 3.0
START_NS = 1_790_000_000_000_000_000


@dataclass(frozen=True, slots=True)
class Potato:
    """An ellipsoid lying on the belt; semi-axes in metres."""

    n: int
    place_x_m: float
    place_y_m: float
    semi_m: tuple[float, float, float]
    yaw: float

    @property
    def weight_g(self) -> float:
        """By volume at 1.08 g/ml."""
        a, b, c = self.semi_m
        return 4 / 3 * np.pi * a * b * c * 1.08e6


def potatoes(count: int, *, seed: int, spacing_m: float = 0.06) -> list[Potato]:
    """`count` tubers, one after the other against the travel, spread over the belt's width."""
    rng = np.random.default_rng(seed)
    made = []
    for n in range(count):
        a, b, c = rng.uniform(0.028, 0.06), rng.uniform(0.022, 0.036), rng.uniform(0.018, 0.03)
        y = (-0.16, 0.0, 0.16)[n % 3] + rng.uniform(-0.02, 0.02)
        made.append(Potato(n, -0.2 - n * spacing_m, y, (a, b, c), rng.uniform(0, np.pi)))
    return made


def moment_ns(seq: int) -> int:
    """Capture time of frame `seq`."""
    return START_NS + int(seq * 1e9 / FPS)


def travel_m(seq: int) -> float:
    """Belt travel at frame `seq`."""
    return SPEED_MPS * seq / FPS


def labelled_depth(
    seq: int, tubers: list[Potato], lens: Intrinsics = LENS
) -> tuple[NDArray[np.uint16], NDArray[np.int64]]:
    """Depth (units of `SCALE_M`) and instance labels (-1: belt) of frame `seq`, seen straight from above."""
    v, u = np.mgrid[: lens.height, : lens.width]
    ray_x, ray_y = (v - lens.cy) / lens.fy, (u - lens.cx) / lens.fx
    depth_m = np.full(u.shape, BELT_DISTANCE_M)
    label = np.full(u.shape, -1)
    for tuber in tubers:
        x = tuber.place_x_m + travel_m(seq)
        if abs(x) > 0.35:
            continue
        a, b, c = tuber.semi_m
        near = BELT_DISTANCE_M - c  # the outline is taken at the height of its widest section
        dx, dy = ray_x * near - x, ray_y * near - tuber.place_y_m
        along = dx * np.cos(tuber.yaw) + dy * np.sin(tuber.yaw)
        across = -dx * np.sin(tuber.yaw) + dy * np.cos(tuber.yaw)
        inside = (along / a) ** 2 + (across / b) ** 2
        surface = near - c * np.sqrt(np.clip(1 - inside, 0, None))
        hit = (inside < 1) & (surface < depth_m)
        depth_m[hit], label[hit] = surface[hit], tuber.n
    return np.rint(depth_m / SCALE_M).astype(np.uint16), label


def frame(seq: int, tubers: list[Potato], *, camera: str = "front", run: str = RUN, lens: Intrinsics = LENS) -> Frame:
    """Frame `seq` of the belt."""
    depth, _ = labelled_depth(seq, tubers, lens)
    return Frame(camera, run, seq, moment_ns(seq), travel_m(seq), SCALE_M, lens, BELT_DISTANCE_M, depth)


def crossing_seq(tuber: Potato) -> int:
    """Frame in which the tuber's centre crosses the centre row."""
    return round(-tuber.place_x_m / SPEED_MPS * FPS)


def view(seq: int, tuber: Potato, tubers: list[Potato], *, rank: int = 0, lens: Intrinsics = LENS) -> View:
    """The tuber as seen in frame `seq`."""
    depth, label = labelled_depth(seq, tubers, lens)
    rows, columns = np.nonzero(label == tuber.n)
    v0, v1, u0, u1 = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
    crop = np.where(label[v0:v1, u0:u1] == tuber.n, depth[v0:v1, u0:u1], 0).astype(np.uint16)
    pose = straight_down_belt_from_camera(BELT_DISTANCE_M)
    track = f"{RUN}/front/{tuber.n}"
    return View(
        f"{track}/{seq}", track, "front", RUN, seq, moment_ns(seq), rank, SCALE_M, lens, int(u0), int(v0), crop, pose
    )


def counted(tuber: Potato, *, run: str = RUN) -> Tuber:
    """The tuber as the aggregator commits it."""
    a, b, c = (2000 * s for s in tuber.semi_m)
    return Tuber(
        tuber_id=tuber.n + 1,
        run=run,
        crossed_ns=moment_ns(crossing_seq(tuber)),
        place_x_m=tuber.place_x_m,
        place_y_m=tuber.place_y_m,
        weight_g=tuber.weight_g,
        low_g=0.9 * tuber.weight_g,
        high_g=1.1 * tuber.weight_g,
        length_mm=a,
        width_mm=b,
        height_mm=c,
        views=3,
        method="pointraft",
        model="test",
        flags=(),
        cameras=("front",),
        tracks=(f"{RUN}/front/{tuber.n}",),
    )


def in_view(seq: int, *tracks: tuple[Potato, float | None], camera: str = "front") -> TracksInView:
    """What a camera has in view at frame `seq`, each with its weight so far."""
    return TracksInView(
        camera,
        RUN,
        moment_ns(seq),
        tuple(
            TrackInView(
                f"{RUN}/{camera}/{tuber.n}", tuber.place_x_m, tuber.place_y_m, 60.0, 45.0, "open",
                grams, None if grams is None else 0.8 * grams, None if grams is None else 1.2 * grams,
            )
            for tuber, grams in tracks
        ),
    )  # fmt: skip


def totals(tubers: list[Potato], *, run: str = RUN, final: bool = False) -> Totals:
    """The load of these tubers."""
    weight = sum(t.weight_g for t in tubers)
    counts = np.bincount([int(t.weight_g // 50) for t in tubers], minlength=8) if tubers else np.zeros(8, int)
    return Totals(
        run=run,
        count=len(tubers),
        weight_g=weight,
        low_g=0.97 * weight,
        high_g=1.03 * weight,
        coverage=0.985,
        estimated_weight_g=weight / 0.985,
        estimated_low_g=0.95 * weight,
        estimated_high_g=1.06 * weight,
        tubers_per_s=5.0,
        histogram_step_g=50.0,
        histogram=tuple(int(n) for n in counts),
        cameras={"front": "ended" if final else "streaming"},
        final=final,
    )


def camera_info(*, run: str = RUN, camera: str = "front", lens: Intrinsics = LENS) -> CameraInfo:
    """A streaming camera."""
    return CameraInfo(camera, run, "streaming", "test", FPS, False, lens, SCALE_M, 0, 0, 1, {})


def within(seconds: float, condition: Callable[[], bool], what: str) -> None:
    """Poll until `condition` holds, or fail saying `what` did not happen; a busy machine gets three times as long."""
    deadline = time.monotonic() + BUSY * seconds
    while not condition():
        assert time.monotonic() < deadline, f"not within {BUSY * seconds:g} s: {what}"
        time.sleep(0.02)


@contextlib.contextmanager
def router() -> Iterator[LinkConfig]:
    """A router process, and the link to it."""
    link = LinkConfig(router=f"tcp/127.0.0.1:{free_port()}")
    command = [sys.executable, "-m", "tuberline", "router", "--listen", link.router]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    try:
        yield link
    finally:
        process.terminate()
        process.wait(30)


@dataclass(slots=True)
class ViewerProcess:
    """A running viewer and an observer that reads its counters."""

    process: subprocess.Popen[bytes]
    observer: Observer

    def counter(self, name: str) -> int:
        """What the viewer last reported of a counter, -1 before its first report."""
        report = self.observer.nodes().get("viewer/test")
        return report.values.get(name, 0) if report else -1

    def gauge(self, name: str) -> float:
        """What the viewer last reported of a level."""
        report = self.observer.nodes().get("viewer/test")
        return report.gauges.get(name, 0.0) if report else -1.0

    def settled(self, sink: str) -> bool:
        """Everything offered to a sink was sent or counted as dropped."""
        drops = ("superseded", "full", "link", "failed", "size_limit")
        done = self.counter(f"{sink}_sent") + sum(self.counter(f"{sink}_dropped_{why}") for why in drops)
        return self.counter(f"{sink}_offered") == done > 0

    def stop(self) -> None:
        """SIGTERM, and it ends with code 0: by its own clock within 2 s, for later it leaves with 70."""
        self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(30)
        assert code == 0, f"viewer ended with code {code}"


@contextlib.contextmanager
def viewer(link: LinkConfig, tmp_path: Path, *options: str, more: str = "") -> Iterator[ViewerProcess]:
    """A viewer process on line 'line' that has announced itself; `more` of the line's file."""
    config = tmp_path / "line.toml"
    config.write_text(f'[link]\nrouter = "{link.router}"\n{more}')
    command = [sys.executable, "-m", "tuberline", "viewer", "--config", str(config), "--name", "test", *options]
    with Observer(link, line="line") as observer:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, env={**os.environ, "OMP_NUM_THREADS": "1"})
        try:
            within(30, lambda: "viewer/test" in observer.alive(), "the viewer announces itself")
            yield ViewerProcess(process, observer)
        finally:
            if process.poll() is None:
                process.kill()
                process.wait(30)


def column(path: Path, entity: str, component: str, timeline: str = "capture") -> list[tuple[Any, Any]]:
    """(time, value) of every row of a component, in order of time."""
    from rerun.chunk import RrdReader

    rows: list[tuple[Any, Any]] = []
    for chunk in RrdReader(path).stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if component in batch.schema.names and timeline in batch.schema.names:
            rows += zip(
                batch.column(timeline).cast("int64").to_pylist(), batch.column(component).to_pylist(), strict=True
            )
    return sorted((row for row in rows if row[1] is not None), key=lambda row: row[0])
